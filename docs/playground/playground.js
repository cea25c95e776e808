// The playground: a page with settings, whose runs a worker computes, and the comparison of all filters.

import { Comparison } from "playground/comparison";
import {
  AddressFormat,
  addLiar,
  describeRun,
  FILTERS,
  formatCommand,
  limitLiars,
  MAX_SAMPLES,
  makeJob,
  miscalibrateMore,
} from "playground/settings";
import { chartsOf } from "view/charts";
import { decodeBase64, History } from "view/history";
import { createElement, findElement, meanEstimate, writeText } from "view/panels";
import { View } from "view/view";
import { formatPercent } from "view/words";

const MILLISECONDS_BETWEEN_ADDRESSES = 200; // browsers refuse addresses that change at every move of a slider
const MILLISECONDS_BETWEEN_CHARTS = 100;

/** Puts what playground.html adds at the end of the page to where it belongs. */
function placeElements() {
  const [main, footer] = ["main", "footer"].map((name) => document.querySelector(name));
  const stage = createElement("div");
  stage.id = "stage";
  document.body.prepend(stage);
  stage.append(findElement("about"), findElement("beliefs"), main, findElement("actions"), footer);
  findElement("world").after(findElement("settings"));
  findElement("charts").before(findElement("filters"));
  findElement("actions").prepend(findElement("play"));
  findElement("lost").after(findElement("liars"));
  stage.after(findElement("examples"), findElement("below"), findElement("command"));
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
const ADDRESS_FORMAT = new AddressFormat(findLimits());

// --- The page ---------------------------------------------------------------------------------------------

class Playground {
  /** Connects the controls of the page, and asks for the run of the page's address. */
  constructor(view, module) {
    this.view = view;
    this.jobId = 0;
    this.settings = ADDRESS_FORMAT.parse(location.hash);
    this.worker = new Worker(import.meta.resolve("playground/worker"));
    this.worker.addEventListener("message", ({ data }) => this.#handleResult(data));
    this.worker.postMessage({ module });
    this.view.onDraw = (state) => this.#showBelief(state);
    this.#createFilterChoices();
    this.#connectControls();
    this.#connectActions();
    this.#connectSite();
    this.#requestRun(true);
  }

  #connectControls() {
    findElement("settings").addEventListener("input", ({ target }) => {
      const value = Number(target.type === "checkbox" ? target.checked : target.value);
      this.#changeSettings({ ...this.settings, [target.name]: value });
    });
    for (const button of findElement("presets").children) {
      button.addEventListener("click", () =>
        this.#changeSettings(ADDRESS_FORMAT.parse(button.dataset.address)),
      );
    }
    addEventListener("hashchange", () => this.#changeSettings(ADDRESS_FORMAT.parse(location.hash)));
  }

  #connectActions() {
    const connect = (id, change) =>
      findElement(id).addEventListener("click", () => {
        this.shouldRestart = true;
        this.#changeSettings(change(this.settings));
      });
    connect("miscalibrate", miscalibrateMore);
    connect("add-liar", addLiar);
    connect("start-over", () => ADDRESS_FORMAT.parse(""));
    const moreButton = findElement("more");
    moreButton.addEventListener("click", () => {
      const isOpen = document.body.classList.toggle("more");
      moreButton.setAttribute("aria-expanded", String(isOpen));
    });
  }

  /** Adds a choice for each filter, in its colour, with room for its error. */
  #createFilterChoices() {
    for (const [name, { words }] of Object.entries(FILTERS)) {
      const label = createElement("label");
      label.style.setProperty("--colour", `var(--${name})`);
      const choice = Object.assign(createElement("input"), { type: "radio", name: "filter", value: name });
      choice.addEventListener("change", () => this.#changeSettings({ ...this.settings, filter: name }));
      label.append(choice, createElement("span", words), createElement("output"));
      findElement("filters").append(label);
    }
  }

  /** Takes other settings: asks for their run, and writes them into the address. */
  #changeSettings(settings) {
    const oldAddress = ADDRESS_FORMAT.format({ ...this.settings, filter: "" });
    const newAddress = ADDRESS_FORMAT.format({ ...settings, filter: "" });
    const { player } = this.view;
    // At the end of a run nothing would move, and so nobody would see what has changed.
    if (newAddress !== oldAddress && player.tick >= player.end) this.shouldRestart = true;
    this.settings = limitLiars(settings);
    this.#requestRun(newAddress !== oldAddress);
    const address = ADDRESS_FORMAT.format(this.settings);
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => {
      window.history.replaceState(null, "", address);
      this.#postToSite({ address });
    }, MILLISECONDS_BETWEEN_ADDRESSES);
  }

  /** Asks the worker for the run of the settings; if more than the filter is new, all errors are, too. */
  #requestRun(hasNewErrors) {
    const job = { ...makeJob(this.settings), id: ++this.jobId };
    if (hasNewErrors) this.comparison = new Comparison(job.interval, job.trials);
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
    const [, code] = findElement("command").children;
    const words = formatCommand(this.settings).split(" ");
    code.replaceChildren(...words.flatMap((word) => [" ", createElement("span", word)]).slice(1));
    findElement("liars").hidden = job.liars === 0;
    const isDefault =
      ADDRESS_FORMAT.format(this.settings) === ADDRESS_FORMAT.format(ADDRESS_FORMAT.parse(""));
    findElement("start-over").disabled = isDefault;
    findElement("miscalibrate").disabled = job.flawed === miscalibrateMore(job).flawed;
    findElement("add-liar").disabled = job.liars === addLiar(job).liars;
    this.#showFinalErrors();
    this.#showStory();
  }

  /** Marks the example whose settings are the present ones, and shows its story. */
  #showStory() {
    const address = ADDRESS_FORMAT.format(this.settings);
    findElement("story").textContent = "";
    for (const button of findElement("presets").children) {
      const isChosen = ADDRESS_FORMAT.format(ADDRESS_FORMAT.parse(button.dataset.address)) === address;
      button.setAttribute("aria-pressed", isChosen);
      if (isChosen) findElement("story").textContent = button.dataset.story;
    }
  }

  /** Takes a result of the worker, unless it belongs to a job before the present one. */
  #handleResult({ id, error, run, records, filter, trial, errors }) {
    if (id !== this.jobId) return;
    if (error) {
      findElement("about").textContent = error;
      return;
    }
    this.comparison.addErrors(filter, trial, errors);
    if (records) this.records = records; // the bits themselves, for tests
    if (run) this.#showRun(run);
    this.view.charts.invalidate();
    this.view.scheduleCharts(MILLISECONDS_BETWEEN_CHARTS);
    this.#showFinalErrors();
  }

  /** Shows the errors at the end of the runs so far: large without and with the chosen filter, small of all. */
  #showFinalErrors() {
    const describe = (name) => this.comparison.describeFinalError(name);
    for (const label of findElement("filters").children) {
      const { value, runs, isComplete } = describe(label.firstElementChild.value);
      writeText(label.lastElementChild, value);
      label.lastElementChild.classList.toggle("unfinished", !isComplete);
      label.title = `points off per robot at the end, ${runs}`;
    }
    const { filter } = this.settings;
    for (const box of document.querySelectorAll("#beliefs .result")) {
      const name = box.dataset.name ?? filter;
      const { value, runs, isComplete } = describe(name);
      const [title, error, note] = box.children;
      box.style.setProperty("--colour", `var(--${name})`);
      box.hidden = filter === "none" && box.dataset.name === undefined;
      writeText(title, `${FILTERS[name].term}, at the end`);
      writeText(error, `off by ${value}`);
      writeText(note, `points, ${runs}`);
      error.classList.toggle("unfinished", !isComplete);
    }
  }

  /** Shows the truth and the mean estimate in a state. */
  #showBelief(state) {
    const { history } = this.view;
    writeText(findElement("truth"), formatPercent(history.description.fill_ratio));
    writeText(findElement("belief"), formatPercent(meanEstimate(history, state), 0));
  }

  /** Shows a run of the worker in the view; the first one is played. */
  #showRun({ ticks, columns, links, ...world }) {
    const { view } = this;
    const job = makeJob(this.settings);
    const history = new History(describeRun(job, world));
    history.appendStates({ ticks, columns, links });
    view.arena.specialColours = new Map(history.description.liars.map((robot) => [robot, "liar"]));
    const isFirst = view.history === null;
    const bHatChart = chartsOf(history).find(({ quantity }) => quantity === "b_hat");
    view.show(history, [this.comparison, bHatChart]);
    view.player.end = history.lastTick;
    if (isFirst || this.shouldRestart) {
      this.shouldRestart = false;
      view.player.seek(0);
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
      if (data.screen) document.documentElement.style.setProperty("--screen", `${data.screen}px`);
      if (data.address !== undefined) this.#changeSettings(ADDRESS_FORMAT.parse(data.address));
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
