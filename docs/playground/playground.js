// The playground: a page with settings, whose runs a worker computes, and the comparison of all filters.

import { chartsOf, FILTER_LABELS, lineOptions } from "view/charts";
import { colour } from "view/colours";
import { decodeBase64, History, ONE } from "view/history";
import { createElement, findElement } from "view/panels";
import { View } from "view/view";

const MAX_SAMPLES = 1000;
const SAMPLES_PER_POINT = 8; // of an error's line
const STEPS_PER_SECOND = 10;
const RADIO_RANGE = 0.7; // metres
const MILLISECONDS_BETWEEN_ADDRESSES = 200; // browsers refuse addresses that change at every move of a slider
const MILLISECONDS_BETWEEN_CHARTS = 100;
const INTEGER_SETTINGS = ["robots", "liars", "seed", "everybody", "steps"];

/** Puts what playground.html adds at the end of the page to where it belongs. */
function placeElements() {
  document.querySelector("header").after(findElement("playground"));
  document.querySelector("main").prepend(findElement("settings"));
  findElement("charts").before(findElement("filters"));
  findElement("legend").lastElementChild.before(findElement("liars"));
  document.querySelector("footer").after(findElement("command"));
  document.body.classList.add("playing");
}

/** Returns the sliders of the settings, each of which has the name, the limits and the default of one. */
function findSliders() {
  return [...findElement("settings").querySelectorAll("[type=range]")];
}

/** Returns the limits and the default of each setting but the filter. */
function findLimits() {
  const limits = findSliders().map(({ name, min, max, defaultValue }) => ({
    name,
    minimum: Number(min),
    maximum: Number(max),
    defaultValue: Number(defaultValue),
  }));
  return [
    ...limits,
    { name: "everybody", minimum: 0, maximum: 1, defaultValue: 0 },
    { name: "steps", minimum: 0, maximum: MAX_SAMPLES, defaultValue: 0 }, // 0 stands for the usual number
  ];
}

placeElements();
const LIMITS = findLimits();
const DEFAULTS = {
  ...Object.fromEntries(LIMITS.map(({ name, defaultValue }) => [name, defaultValue])),
  filter: "asdf-minus",
};

// --- Settings ---------------------------------------------------------------------------------------------

/** Returns the settings with fewer liars, if there are not fewer liars than robots. */
function limitLiars(settings) {
  return { ...settings, liars: Math.min(settings.liars, settings.robots - 1) };
}

/** Returns the settings of an address such as #flawed=50&filter=robust; bad and missing ones have defaults. */
function parseAddress(address) {
  const settings = { ...DEFAULTS };
  const parameters = new URLSearchParams(address.replace(/^#/, ""));
  for (const { name, minimum, maximum } of LIMITS) {
    const value = Number(parameters.get(name) ?? Number.NaN);
    if (value >= minimum && value <= maximum) settings[name] = value;
  }
  for (const name of INTEGER_SETTINGS) settings[name] = Math.floor(settings[name]);
  if (parameters.get("filter") in FILTER_LABELS) settings.filter = parameters.get("filter");
  return limitLiars(settings);
}

/** Returns the address of settings, which has those that are not defaults. */
function formatAddress(settings) {
  const changedNames = Object.keys(DEFAULTS).filter((name) => settings[name] !== DEFAULTS[name]);
  return `#${changedNames.map((name) => `${name}=${settings[name]}`).join("&")}`;
}

/** Returns how many steps a run has by default: fewer if its robots receive so much that it would take long. */
function chooseSteps({ robots, density, everybody }) {
  const neighbours = everybody ? robots - 1 : density;
  const messagesPerStep = robots * neighbours;
  if (messagesPerStep <= 400) return 10000;
  if (messagesPerStep <= 1600) return 5000;
  return 2000;
}

/** Returns settings as the worker takes them, with the number of flawed robots, the steps and their interval. */
function makeJob(settings) {
  const steps = settings.steps || chooseSteps(settings);
  return {
    ...settings,
    flawedCount: Math.floor((settings.flawed / 100) * settings.robots + 0.5),
    steps,
    interval: Math.max(steps / MAX_SAMPLES, 1),
  };
}

/** Returns the command that computes the same bits: of all trials, or of the first one if there are liars. */
function formatCommand(settings) {
  const job = makeJob(settings);
  const options = [
    `--seed ${job.seed} --robots ${job.robots}`,
    job.everybody ? "--topology fully-connected" : `--topology dynamic --density ${job.density}`,
    `--filter ${job.filter} --flawed ${job.flawedCount} --fill-ratio ${job.fill} --steps ${job.steps}`,
    `--flawed-accuracy ${job.wrong} --true-accuracy ${job.accuracy}`,
  ].join(" ");
  if (job.liars === 0) return `mcp-asdf simulate ${options}`;
  // Liars are a fault of a bus, which only `swarm` has.
  const liarIds = `${job.robots - job.liars}-${job.robots - 1}`;
  return `mcp-asdf swarm ${options} --fault liar,robots=${liarIds},x=0,alpha=1e6`;
}

/** Returns the description of a job's run, as `RunDescription` of view/history.py has it. */
function describeRun(job, { sides, floor }) {
  return {
    title: `${job.robots} robots, ${job.flawedCount} flawed, ${FILTER_LABELS[job.filter]}`,
    robots: Array.from({ length: job.robots }, (_, robot) => robot),
    flawed: Array.from({ length: job.flawedCount }, (_, robot) => robot),
    quantities: ["x", "x_hat", "b_hat", "b"],
    fill_ratio: job.fill,
    steps: job.steps,
    steps_per_second: STEPS_PER_SECOND,
    radio_range: RADIO_RANGE,
    sides,
    floor,
  };
}

// --- Comparison of the filters ----------------------------------------------------------------------------

/** Returns the median, the lower and the upper quartile of series at each point. */
function computeQuartiles(series) {
  const sortedByPoint = Array.from(series[0], (_, point) =>
    Float64Array.from(series, (values) => values[point]).sort(),
  );
  const quantile = (share) => sortedByPoint.map((values) => values[Math.round(share * (values.length - 1))]);
  return [quantile(0.5), quantile(0.25), quantile(0.75)];
}

/** Returns means of SAMPLES_PER_POINT values each: from step to step x jumps as neighbours come and go. */
function averageBlocks(values) {
  const blockCount = Math.floor(values.length / SAMPLES_PER_POINT) || 1;
  return Float64Array.from({ length: blockCount }, (_, block) => {
    const start = block * SAMPLES_PER_POINT;
    const blockValues = values.subarray(start, start + SAMPLES_PER_POINT);
    return blockValues.reduce((sum, value) => sum + value, 0) / blockValues.length;
  });
}

/** The errors of all filters in all trials so far, and the chart that shows them. */
class Comparison {
  /** Creates a comparison without errors; `interval` is the number of steps between samples. */
  constructor(interval) {
    this.interval = interval;
    this.chosenFilter = null;
    this.filters = Object.keys(FILTER_LABELS).map((name) => ({ name, trials: [] }));
    this.label = "mean error of x: median and middle half of runs";
    this.names = [];
    this.relativeHeight = 1.6;
    this.hasRobotLines = false;
  }

  /** Adds the errors of a filter in a trial, one for each sample. */
  addErrors(filterName, trial, errors) {
    this.#findFilter(filterName).trials[trial] = averageBlocks(errors);
  }

  #findFilter(filterName) {
    return this.filters.find(({ name }) => name === filterName);
  }

  /** The options of uPlot: for each filter its median, lower and upper quartile, and the run that is shown. */
  get seriesOptions() {
    const transparent = "transparent";
    const colourIfChosen = (name, alpha) => (name === this.chosenFilter ? colour(name) + alpha : transparent);
    const lines = this.filters.flatMap(({ name }) => [
      lineOptions(() => colour(name), 2.2),
      lineOptions(transparent, 1),
      lineOptions(transparent, 1),
      lineOptions(() => colourIfChosen(name, ""), 0.7),
    ]);
    // A band fills the room between two series, which uPlot counts from 1, as 0 is the time.
    const bands = this.filters.map(({ name }, index) => ({
      series: [4 * index + 3, 4 * index + 2],
      fill: () => colourIfChosen(name, "30"),
    }));
    return { series: [{}, ...lines], bands };
  }

  /** Returns uPlot's data: ticks, and the series of `seriesOptions`, null where no trial is known yet. */
  computeData() {
    const firstTrials = this.filters.map(({ trials }) => trials[0]).filter(Boolean);
    const pointCount = firstTrials[0]?.length ?? 1;
    const unknown = new Array(pointCount).fill(null);
    const ticks = Array.from(
      { length: pointCount },
      (_, point) => (point + 0.5) * SAMPLES_PER_POINT * this.interval,
    );
    const series = this.filters.flatMap(({ trials }) => {
      const knownTrials = trials.filter(Boolean);
      if (knownTrials.length === 0) return [unknown, unknown, unknown, unknown];
      return [...computeQuartiles(knownTrials), trials[0] ?? unknown];
    });
    return [ticks, ...series];
  }

  /** Returns the median error at the end of a filter's trials, and their number; null if there are none. */
  finalError(filterName) {
    const knownTrials = this.#findFilter(filterName).trials.filter(Boolean);
    if (knownTrials.length === 0) return null;
    const [[median]] = computeQuartiles(knownTrials.map((errors) => errors.slice(-1)));
    return { median, trialCount: knownTrials.length };
  }
}

// --- The page ---------------------------------------------------------------------------------------------

class Playground {
  /** Connects the controls of the page, and asks for the run of the page's address. */
  constructor(view, module) {
    this.view = view;
    this.jobId = 0;
    this.settings = parseAddress(location.hash);
    this.worker = new Worker(import.meta.resolve("playground/worker"));
    this.worker.addEventListener("message", ({ data }) => this.#handleResult(data));
    this.worker.postMessage({ module });
    this.#createFilterChoices();
    this.#connectControls();
    this.#connectSite();
    this.#requestRun(true);
  }

  #connectControls() {
    findElement("settings").addEventListener("input", ({ target }) => {
      const value = Number(target.type === "checkbox" ? target.checked : target.value);
      this.#changeSettings({ ...this.settings, [target.name]: value });
    });
    for (const button of findElement("presets").children) {
      button.addEventListener("click", () => this.#changeSettings(parseAddress(button.dataset.address)));
    }
    findElement("command").lastElementChild.addEventListener("click", () => this.#copyCommand());
    addEventListener("hashchange", () => this.#changeSettings(parseAddress(location.hash)));
  }

  /** Adds a choice for each filter, in its colour, with room for its error. */
  #createFilterChoices() {
    for (const [name, text] of Object.entries(FILTER_LABELS)) {
      const label = createElement("label");
      label.style.setProperty("--colour", `var(--${name})`);
      const choice = Object.assign(createElement("input"), { type: "radio", name: "filter", value: name });
      choice.addEventListener("change", () => this.#changeSettings({ ...this.settings, filter: name }));
      label.append(choice, createElement("b", text), createElement("output"));
      findElement("filters").append(label);
    }
  }

  /** Copies the command; where a browser does not let a page in a frame do that, the command is selected. */
  async #copyCommand() {
    const [, code, button] = findElement("command").children;
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "copied";
    } catch {
      getSelection().selectAllChildren(code);
    }
  }

  /** Takes other settings: asks for their run, and writes them into the address. */
  #changeSettings(settings) {
    const oldAddress = formatAddress({ ...this.settings, filter: "" });
    const newAddress = formatAddress({ ...settings, filter: "" });
    this.settings = limitLiars(settings);
    this.#requestRun(newAddress !== oldAddress);
    const address = formatAddress(this.settings);
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => {
      window.history.replaceState(null, "", address);
      this.#postToSite({ address });
    }, MILLISECONDS_BETWEEN_ADDRESSES);
  }

  /** Asks the worker for the run of the settings; if more than the filter is new, all errors are, too. */
  #requestRun(hasNewErrors) {
    const job = { ...makeJob(this.settings), id: ++this.jobId };
    if (hasNewErrors) this.comparison = new Comparison(job.interval);
    this.comparison.chosenFilter = job.filter;
    this.view.charts.invalidate();
    this.worker.postMessage(job);
    this.#showSettings(job);
  }

  #showSettings(job) {
    const form = findElement("settings");
    for (const slider of findSliders()) {
      slider.value = this.settings[slider.name];
      slider.previousElementSibling.textContent = this.settings[slider.name];
    }
    form.elements.everybody.checked = job.everybody;
    form.elements.density.disabled = job.everybody;
    for (const choice of findElement("filters").querySelectorAll("input")) {
      choice.checked = choice.value === job.filter;
    }
    const [, code, copyButton] = findElement("command").children;
    code.textContent = formatCommand(this.settings);
    copyButton.textContent = "copy";
    findElement("liars").hidden = job.liars === 0;
    this.#showStory();
  }

  /** Marks the example whose settings are the present ones, and shows its story. */
  #showStory() {
    const address = formatAddress(this.settings);
    findElement("story").textContent = "";
    for (const button of findElement("presets").children) {
      const isChosen = formatAddress(parseAddress(button.dataset.address)) === address;
      button.setAttribute("aria-pressed", isChosen);
      if (isChosen) findElement("story").textContent = button.dataset.story;
    }
  }

  /** Takes a result of the worker, unless it belongs to a job before the present one. */
  #handleResult({ id, error, run, records, filter, trial, errors }) {
    if (id !== this.jobId) return;
    if (error) {
      findElement("story").textContent = error;
      return;
    }
    this.comparison.addErrors(filter, trial, errors);
    if (records) this.records = records; // the bits themselves, for tests
    if (run) this.#showRun(run);
    this.view.charts.invalidate();
    this.view.scheduleCharts(MILLISECONDS_BETWEEN_CHARTS);
    this.#showFinalErrors();
  }

  #showFinalErrors() {
    for (const label of findElement("filters").children) {
      const finalError = this.comparison.finalError(label.firstElementChild.value);
      const output = label.lastElementChild;
      output.textContent = finalError === null ? "…" : finalError.median.toFixed(3);
      if (finalError !== null) {
        label.title = `mean error of x at the end, median of ${finalError.trialCount} runs`;
      }
    }
  }

  /** Shows a run of the worker in the view; the first one is played. */
  #showRun({ columns, links, ...world }) {
    const { view } = this;
    const job = makeJob(this.settings);
    const history = new History(describeRun(job, world));
    const stateCount = job.steps / job.interval + 1;
    const trueAccuracies = new Uint16Array(columns.x.length).fill(Math.round(job.accuracy * ONE));
    history.appendStates({
      ticks: Uint32Array.from({ length: stateCount }, (_, state) => state * job.interval),
      columns: { ...columns, b: trueAccuracies },
      links,
    });
    const liars = Array.from({ length: job.liars }, (_, liar) => job.robots - 1 - liar);
    view.arena.specialColours = new Map(liars.map((robot) => [robot, "liar"]));
    const isFirst = view.history === null;
    const bHatChart = chartsOf(history).find(({ quantity }) => quantity === "b_hat");
    view.show(history, [this.comparison, bHatChart]);
    view.player.end = history.lastTick;
    if (isFirst) {
      view.chooseSpeed(history.lastTick);
      view.player.play();
    }
  }

  // --- Inside a page of the documentation, which has the address, the height and the colours ---

  /** Exchanges address, height and colours with the page that has this one in a frame, if there is one. */
  #connectSite() {
    if (parent === window) return;
    document.documentElement.classList.add("framed");
    addEventListener("message", ({ data, source }) => {
      if (source !== parent) return;
      if (data.theme) {
        document.documentElement.style.colorScheme = data.theme;
        this.view.recolour();
      }
      if (data.address !== undefined) this.#changeSettings(parseAddress(data.address));
    });
    const bodyObserver = new ResizeObserver(() => this.#postToSite({ height: document.body.offsetHeight }));
    bodyObserver.observe(document.body);
    this.#postToSite({ isReady: true });
  }

  #postToSite(message) {
    if (parent !== window) parent.postMessage(message, "*");
  }
}

const { module } = JSON.parse(findElement("history").textContent);
const view = new View({ keepsAddress: false });
view.playground = new Playground(view, decodeBase64(module));
