// The playground: settings, whose runs a worker computes, and what the page shows of them.

import { bytesOf, Film } from "view/film";
import { element, find } from "view/panels";

export const FILTERS = { none: "no filter", "asdf-minus": "ASDF−", "asdf-plus": "ASDF+", robust: "robust" };
const SAMPLES = 1000;
const BLOCK = 8;
const LIMITS = [
  ...[...find("settings").querySelectorAll("[type=range]")].map(({ name, min, max, defaultValue }) => ({
    name,
    from: Number(min),
    to: Number(max),
    value: Number(defaultValue),
  })),
  { name: "everybody", from: 0, to: 1, value: 0 },
  { name: "steps", from: 0, to: SAMPLES, value: 0 },
];
const DEFAULTS = {
  ...Object.fromEntries(LIMITS.map(({ name, value }) => [name, value])),
  filter: "asdf-minus",
};

/** Settings of an address such as #flawed=50&filter=robust; what is not there or out of range has its default. */
function settingsOf(address) {
  const settings = { ...DEFAULTS };
  const given = new URLSearchParams(address.replace(/^#/, ""));
  for (const { name, from, to } of LIMITS) {
    const value = Number(given.get(name) ?? Number.NaN);
    if (value >= from && value <= to) settings[name] = value;
  }
  for (const name of ["robots", "liars", "seed", "everybody", "steps"])
    settings[name] = Math.floor(settings[name]);
  if (given.get("filter") in FILTERS) settings.filter = given.get("filter");
  settings.liars = Math.min(settings.liars, settings.robots - 1);
  return settings;
}

/** The address of settings: those that are not defaults. */
function addressOf(settings) {
  const given = Object.keys(DEFAULTS).filter((name) => settings[name] !== DEFAULTS[name]);
  return `#${given.map((name) => `${name}=${settings[name]}`).join("&")}`;
}

/** Settings as the worker takes them: fewer steps where robots hear so many others that a run would last. */
function jobOf(settings) {
  const { robots, density, everybody, flawed, steps } = settings;
  const heard = robots * (everybody ? robots - 1 : density);
  const usual = heard <= 400 ? 10000 : heard <= 1600 ? 5000 : 2000;
  const chosen = steps || usual;
  const interval = Math.max(chosen / SAMPLES, 1);
  return { ...settings, flawedCount: Math.floor((flawed / 100) * robots + 0.5), steps: chosen, interval };
}

/** The command that computes the same bits: of all trials, or, as liars are faults of a bus, of the first. */
function commandOf(settings) {
  const { seed, robots, everybody, density, filter, flawedCount, fill, ...job } = jobOf(settings);
  const topology = everybody ? "fully-connected" : `dynamic --density ${density}`;
  const swarm = `--seed ${seed} --robots ${robots} --topology ${topology} --filter ${filter}`;
  const options = `${swarm} --flawed ${flawedCount} --fill-ratio ${fill} --steps ${job.steps}`;
  const accuracies = `--flawed-accuracy ${job.wrong} --true-accuracy ${job.accuracy}`;
  if (job.liars === 0) return `mcp-asdf simulate ${options} ${accuracies}`;
  const fault = `liar,robots=${robots - job.liars}-${robots - 1},x=0,alpha=1e6`;
  return `mcp-asdf swarm ${options} ${accuracies} --fault ${fault}`;
}

/** Median, lower and upper quartile at each point of series. O(series log(series) points). */
function quartiles(series) {
  const sorted = Array.from(series[0], (_, point) => Float64Array.from(series, (each) => each[point]).sort());
  const at = (share) => sorted.map((values) => values[Math.round(share * (values.length - 1))]);
  return [at(0.5), at(0.25), at(0.75)];
}

/** Means of blocks of a series: from step to step x jumps as neighbours come and go. */
function means(series) {
  return Float64Array.from({ length: Math.floor(series.length / BLOCK) || 1 }, (_, block) => {
    const part = series.subarray(block * BLOCK, (block + 1) * BLOCK);
    return part.reduce((sum, value) => sum + value, 0) / part.length;
  });
}

/** Errors of all filters and trials, as the first chart draws them. */
class Comparison {
  constructor() {
    this.filters = Object.keys(FILTERS).map((name) => ({ name, trials: [] }));
    this.isNew = true;
  }

  add(filter, trial, errors) {
    this.filters.find(({ name }) => name === filter).trials[trial] = means(errors);
    this.isNew = true;
  }

  /** Data for uPlot: ticks, then for each filter median and quartiles of the runs so far, and this run. */
  data() {
    this.isNew = false;
    const length = this.filters.find(({ trials }) => trials[0])?.trials[0].length ?? 1;
    const nothing = new Array(length).fill(null);
    const ticks = Array.from({ length }, (_, block) => (block + 0.5) * BLOCK * this.interval);
    const rows = this.filters.flatMap(({ trials }) => {
      const found = trials.filter(Boolean);
      if (found.length === 0) return [nothing, nothing, nothing, nothing];
      return [...quartiles(found), trials[0] ?? nothing];
    });
    return [ticks, ...rows];
  }

  /** The error at the end of a filter's runs, as a median, and of how many. */
  ends(filter) {
    const found = this.filters.find(({ name }) => name === filter).trials.filter(Boolean);
    if (!found.length) return null;
    const [[median]] = quartiles(found.map((errors) => errors.slice(-1)));
    return { median, count: found.length };
  }
}

export class Playground {
  constructor(view, module) {
    this.view = view;
    this.id = 0;
    this.comparison = new Comparison();
    this.settings = settingsOf(location.hash);
    find("settings").addEventListener("input", ({ target }) => {
      const value = Number(target.type === "checkbox" ? target.checked : target.value);
      this.#change({ ...this.settings, [target.name]: value });
    });
    for (const button of find("presets").children)
      button.addEventListener("click", () => this.#change(settingsOf(button.dataset.address)));
    this.#makeFilters();
    find("command").lastElementChild.addEventListener("click", () => this.#copy());
    for (const name of ["playground", "settings", "filters", "command"]) find(name).hidden = false;
    document.body.classList.add("playing");
    addEventListener("hashchange", () => this.#change(settingsOf(location.hash)));
    this.worker = new Worker(import.meta.resolve("view/worker"));
    this.worker.addEventListener("message", ({ data }) => this.#take(data));
    this.worker.postMessage({ module: bytesOf(module) });
    this.#listenToSite();
    this.#ask(true);
  }

  /** Copies the command; where a browser does not let a page in a frame do that, it is selected. */
  async #copy() {
    const [, code, button] = find("command").children;
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "copied";
    } catch {
      getSelection().selectAllChildren(code);
    }
  }

  #makeFilters() {
    for (const [name, label] of Object.entries(FILTERS)) {
      const row = element("label");
      row.style.setProperty("--colour", `var(--${name})`);
      const choice = Object.assign(element("input"), { type: "radio", name: "filter", value: name });
      choice.addEventListener("change", () => this.#change({ ...this.settings, filter: name }));
      row.append(choice, element("b", label), element("output"));
      find("filters").append(row);
    }
  }

  /** Takes other settings: the whole run is computed again. */
  #change(settings) {
    const isOtherRun = addressOf({ ...settings, filter: "" }) !== addressOf({ ...this.settings, filter: "" });
    this.settings = { ...settings, liars: Math.min(settings.liars, settings.robots - 1) };
    this.#ask(isOtherRun);
    const address = addressOf(this.settings);
    clearTimeout(this.addressDue); // browsers refuse addresses that change at every move of a slider
    this.addressDue = setTimeout(() => {
      history.replaceState(null, "", address);
      this.#tellSite({ address });
    }, 200);
  }

  #ask(isOtherRun) {
    if (isOtherRun) this.comparison = new Comparison();
    this.id++;
    const job = { ...jobOf(this.settings), id: this.id };
    Object.assign(this.comparison, { interval: job.interval, chosen: job.filter, isNew: true });
    this.worker.postMessage(job);
    this.#showSettings(job);
  }

  #showSettings(job) {
    for (const slider of find("settings").querySelectorAll("[type=range]")) {
      slider.value = this.settings[slider.name];
      slider.previousElementSibling.textContent = this.settings[slider.name];
    }
    find("settings").elements.everybody.checked = job.everybody;
    find("settings").elements.density.disabled = job.everybody;
    for (const choice of find("filters").querySelectorAll("input"))
      choice.checked = choice.value === job.filter;
    find("command").children[1].textContent = commandOf(this.settings);
    const address = addressOf(this.settings);
    find("command").lastElementChild.textContent = "copy";
    find("liars").hidden = job.liars === 0;
    find("story").textContent = "";
    for (const button of find("presets").children) {
      const isChosen = addressOf(settingsOf(button.dataset.address)) === address;
      button.setAttribute("aria-pressed", isChosen);
      if (isChosen) find("story").textContent = button.dataset.story;
    }
  }

  #take({ id, error, film, filter, trial, errors, words }) {
    if (id !== this.id) return;
    if (error) {
      find("story").textContent = error;
      return;
    }
    this.comparison.add(filter, trial, errors);
    if (film) this.#show(film);
    if (words) this.words = words; // the bits themselves, for tests
    this.view.chartsDue = Math.min(this.view.chartsDue, performance.now() + 100);
    for (const row of find("filters").children) {
      const ends = this.comparison.ends(row.firstElementChild.value);
      row.lastElementChild.textContent = ends ? ends.median.toFixed(3) : "…";
      if (ends) row.title = `mean error of x at the end, median of ${ends.count} runs`;
    }
  }

  #show({ sides, floor, links, columns, px, py }) {
    const { view, settings } = this;
    const job = jobOf(settings);
    const stage = {
      title: `${job.robots} robots, ${job.flawedCount} flawed, ${FILTERS[job.filter]}`,
      robots: Array.from({ length: job.robots }, (_, robot) => robot),
      flawed: Array.from({ length: job.flawedCount }, (_, robot) => robot),
      liars: Array.from({ length: job.liars }, (_, liar) => job.robots - 1 - liar),
      quantities: ["x", "x_hat", "b_hat", "b"],
      fill_ratio: job.fill,
      steps: job.steps,
      steps_per_second: 10,
      radio_range: 0.7,
      sides,
      floor,
    };
    const b = new Uint16Array(columns.x.length).fill(Math.round(job.accuracy * 65534));
    const film = Film.of(stage, job.interval, { ...columns, b, px, py }, links);
    film.comparison = this.comparison;
    const isFirst = view.film === null;
    view.show(film);
    view.player.end = film.lastTick;
    if (isFirst) view.chooseSpeed(film.lastTick);
    if (isFirst) view.player.play();
  }

  // --- Inside a page of the documentation, which has the address, the height and the colours ---

  #listenToSite() {
    if (parent === window) return;
    document.documentElement.classList.add("framed");
    addEventListener("message", ({ data, source }) => {
      if (source !== parent) return;
      if (data.theme) {
        document.documentElement.style.colorScheme = data.theme;
        this.view.recolour();
      }
      if (data.address !== undefined) this.#change(settingsOf(data.address));
    });
    new ResizeObserver(() => this.#tellSite({ height: document.body.offsetHeight })).observe(document.body);
    this.#tellSite({ isReady: true });
  }

  #tellSite(message) {
    if (parent !== window) parent.postMessage(message, "*");
  }
}
