// The playground: a page with settings, whose runs a worker computes, and the comparison of all filters.

import { Comparison } from "playground/comparison";
import {
  AddressFormat,
  describeRun,
  formatCommand,
  limitLiars,
  MAX_SAMPLES,
  makeJob,
} from "playground/settings";
import { chartsOf, FILTER_LABELS } from "view/charts";
import { decodeBase64, History, ONE } from "view/history";
import { createElement, findElement } from "view/panels";
import { View } from "view/view";

const MILLISECONDS_BETWEEN_ADDRESSES = 200; // browsers refuse addresses that change at every move of a slider
const MILLISECONDS_BETWEEN_CHARTS = 100;

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
      button.addEventListener("click", () =>
        this.#changeSettings(ADDRESS_FORMAT.parse(button.dataset.address)),
      );
    }
    findElement("command").lastElementChild.addEventListener("click", () => this.#copyCommand());
    addEventListener("hashchange", () => this.#changeSettings(ADDRESS_FORMAT.parse(location.hash)));
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
    const oldAddress = ADDRESS_FORMAT.format({ ...this.settings, filter: "" });
    const newAddress = ADDRESS_FORMAT.format({ ...settings, filter: "" });
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
