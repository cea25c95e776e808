// The playground: settings, whose runs a worker computes, and what the page shows of them.

import { Film } from "view/film";
import { element, find } from "view/panels";

const SLIDERS = [
  { name: "robots", label: "robots", from: 2, to: 127, step: 1, value: 20 },
  { name: "flawed", label: "flawed robots, %", from: 0, to: 100, step: 5, value: 50 },
  { name: "wrong", label: "b_hat they start with", from: 0.05, to: 0.99, step: 0.01, value: 0.55 },
  { name: "accuracy", label: "b, true accuracy", from: 0.5, to: 1, step: 0.01, value: 0.95 },
  { name: "fill", label: "f, share of black tiles", from: 0, to: 1, step: 0.05, value: 0.55 },
  { name: "liars", label: "liars", from: 0, to: 10, step: 1, value: 0 },
  { name: "density", label: "D, density", from: 0.2, to: 10, step: 0.2, value: 1 },
  { name: "seed", label: "seed", from: 1, to: 1000, step: 1, value: 1 },
];
export const FILTERS = { none: "no filter", "asdf-minus": "ASDF−", "asdf-plus": "ASDF+", robust: "robust" };
export const COLOURS = { none: "none", "asdf-minus": "minus", "asdf-plus": "plus", robust: "robust" };
const PRESETS = [
  [
    "half the robots are wrong",
    "",
    "Half of twenty robots think that their sensors are hardly better than a coin; they hear those nearby, compare notes, and recalibrate themselves.",
  ],
  [
    "a few are wrong, nobody knows which",
    "flawed=30&filter=robust",
    "Six of twenty robots are wrong about their sensors and do not know it: with the robust filter all may recalibrate, and the right ones stay right.",
  ],
  [
    "a liar",
    "flawed=20&liars=1&filter=robust",
    "One robot claims, with great confidence, that no tile is black: whoever weighs messages by confidence believes it, the robust filter counts it as one vote.",
  ],
  [
    "everybody hears everybody",
    "everybody=1&filter=none",
    "You need no filter: where all hear all, the sound robots outvote the flawed ones, whose confidence is low.",
  ],
  [
    "few neighbours",
    "density=0.4",
    "Robots meet seldom, so each is alone with its own sensor for long: here it matters most to know how good that is.",
  ],
  [
    "127 robots",
    "robots=127",
    "A hundred more change nothing for the robot: its cost depends on the neighbours that it hears.",
  ],
];
const DEFAULTS = {
  ...Object.fromEntries(SLIDERS.map(({ name, value }) => [name, value])),
  everybody: 0,
  steps: 0,
  filter: "asdf-minus",
};
const SAMPLES = 1000;
const BLOCK = 8;

/** Settings of an address such as #flawed=50&filter=robust; what is not there or out of range has its default. */
export function settingsOf(address) {
  const settings = { ...DEFAULTS };
  const given = new URLSearchParams(address.replace(/^#/, ""));
  for (const { name, from, to } of [
    ...SLIDERS,
    { name: "everybody", from: 0, to: 1 },
    { name: "steps", from: 0, to: SAMPLES },
  ]) {
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
export function addressOf(settings) {
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
export function commandOf(settings) {
  const job = jobOf(settings);
  const isLied = job.liars > 0;
  const words = {
    seed: job.seed,
    robots: job.robots,
    topology: job.everybody ? "fully-connected" : "dynamic",
    density: job.everybody ? null : job.density,
    filter: job.filter,
    flawed: job.flawedCount,
    "fill-ratio": job.fill,
    steps: job.steps,
  };
  const accuracies = { "flawed-accuracy": job.wrong, "true-accuracy": job.accuracy };
  const rest = Object.entries(words).filter(([, value]) => value !== null);
  const options = rest.map(([name, value]) => `--${name} ${value}`);
  for (const [name, value] of Object.entries(accuracies)) {
    options.push(isLied ? `--set ${name.replace("-", "_")}=${value}` : `--${name} ${value}`);
  }
  if (!isLied) return `mcp-asdf simulate ${options.join(" ")}`;
  const ids = `${job.robots - job.liars}-${job.robots - 1}`;
  return `mcp-asdf swarm ${options.join(" ")} --fault liar,robots=${ids},x=0,alpha=1e6`;
}

/** Lower quartile, median and upper quartile at each point of series. O(series log(series) points). */
function quartiles(series) {
  const [low, middle, high] = [[], [], []];
  const values = new Float64Array(series.length);
  for (let point = 0; point < series[0].length; point++) {
    series.forEach((each, trial) => {
      values[trial] = each[point];
    });
    values.sort();
    const at = (share) => values[Math.round(share * (values.length - 1))];
    low.push(at(0.25));
    middle.push(at(0.5));
    high.push(at(0.75));
  }
  return { low, middle, high };
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
    this.filters = Object.entries(FILTERS).map(([name, label]) => ({
      name,
      label,
      colour: COLOURS[name],
      trials: [],
    }));
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
      const { low, middle, high } = quartiles(found);
      return [middle, low, high, trials[0] ?? nothing];
    });
    return [ticks, ...rows];
  }

  /** The error at the end of a filter's runs, as a median, and of how many. */
  ends(filter) {
    const found = this.filters.find(({ name }) => name === filter).trials.filter(Boolean);
    if (!found.length) return null;
    const { middle } = quartiles(found.map((errors) => errors.slice(-1)));
    return { median: middle[0], count: found.length };
  }
}

export class Playground {
  constructor(view, module) {
    this.view = view;
    this.id = 0;
    this.comparison = new Comparison();
    this.settings = settingsOf(location.hash);
    this.#makeSettings();
    this.#makePresets();
    this.#makeFilters();
    find("command").lastElementChild.addEventListener("click", () => this.#copy());
    for (const name of ["playground", "settings", "filters", "command"]) find(name).hidden = false;
    document.body.classList.add("playing");
    addEventListener("hashchange", () => this.#change(settingsOf(location.hash)));
    this.worker = new Worker(import.meta.resolve("view/worker"));
    this.worker.addEventListener("message", ({ data }) => this.#take(data));
    this.worker.postMessage({ module: Uint8Array.from(atob(module), (letter) => letter.charCodeAt(0)) });
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

  #makeSettings() {
    for (const { name, label, from, to, step } of SLIDERS) {
      const row = element("label", label);
      const shown = element("output");
      const slider = Object.assign(element("input"), { type: "range", name, min: from, max: to, step });
      slider.addEventListener("input", () =>
        this.#change({ ...this.settings, [name]: Number(slider.value) }),
      );
      row.append(shown, slider);
      find("settings").append(row);
    }
    const everybody = Object.assign(element("input"), { type: "checkbox", name: "everybody" });
    everybody.addEventListener("change", () =>
      this.#change({ ...this.settings, everybody: Number(everybody.checked) }),
    );
    const row = element("label", "everybody hears everybody", "check");
    row.prepend(everybody);
    find("settings").append(row);
  }

  #makePresets() {
    for (const [name, address, story] of PRESETS) {
      const button = Object.assign(element("button", name), { type: "button" });
      button.dataset.address = addressOf(settingsOf(address));
      button.dataset.story = story;
      button.addEventListener("click", () => this.#change(settingsOf(address)));
      find("presets").append(button);
    }
  }

  #makeFilters() {
    for (const [name, label] of Object.entries(FILTERS)) {
      const row = element("label");
      row.style.setProperty("--colour", `var(--${COLOURS[name]})`);
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
    for (const { name } of SLIDERS) {
      const slider = find("settings").elements[name];
      slider.value = this.settings[name];
      slider.previousElementSibling.textContent = this.settings[name];
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
      const isChosen = button.dataset.address === address;
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
    if (isFirst) view.player.play();
    if (isFirst) view.chooseSpeed(film.lastTick);
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
