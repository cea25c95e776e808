// Charts of all robots over time. Long films are thinned to the extremes of each column of the screen.

import { colour, colourOfError } from "view/colours";
import { element } from "view/panels";
import { FILTERS } from "view/playground";

const COLUMNS = 480;
const MEAN = { label: "mean error of x: ", data: meanErrors };
const ERROR = {
  label: "mean error of x: median and middle half of runs",
  data: (film) => film.comparison.data(),
};
const PANELS = [
  { name: "b_hat", label: "b_hat: trust in the own sensor", symbol: "b" },
  { name: "x_hat", label: "x_hat: what each sees by itself", symbol: "f" },
  { name: "x", label: "x: what each believes after hearing its neighbours", symbol: "f" },
];

/** First and end of the samples in each column of the screen. */
function columnsOf(film) {
  const count = Math.min(COLUMNS, film.length);
  const start = (column) => Math.floor((column * film.length) / count);
  return Array.from({ length: count }, (_, column) => [start(column), start(column + 1)]);
}

/** Smallest and largest value of each column, as data for uPlot: ticks, a row per robot, then the truth. */
function thinned(film, { name, symbol }) {
  const columns = columnsOf(film);
  const { ticks } = film;
  const series = film.stage.robots.map((_, robot) =>
    columns.flatMap(([first, end]) => extremes(film, name, robot, first, end)),
  );
  return [
    columns.flatMap(([first, end]) => [ticks[first], ticks[end - 1] + (end - first === 1 ? 1e-6 : 0)]),
    ...series,
    columns.flatMap(([first]) => new Array(2).fill(truthOf(film, symbol, first))),
  ];
}

/** Mean error of x over time, and that of the twin without a filter, as data for uPlot. O(samples robots). */
function meanErrors(film) {
  const { fill_ratio: f, twin = [], steps } = film.stage;
  const columns = columnsOf(film);
  const ticks = columns.map(([first]) => film.ticks[first]);
  const errors = columns.map(([first, end]) => {
    let [sum, count] = [0, 0];
    for (let at = first * film.robots; at < end * film.robots; at++) {
      const x = film.value("x", at % film.robots, Math.floor(at / film.robots));
      if (!Number.isNaN(x)) [sum, count] = [sum + Math.abs(x - f), count + 1];
    }
    return count ? sum / count : null;
  });
  const part = (tick) => Math.min(Math.floor((tick * twin.length) / (steps + 1)), twin.length - 1);
  return [ticks, errors, ticks.map((tick) => twin[part(tick)] ?? null)];
}

/** The colour of a robot's line: at each time that of the robot on the floor. */
function stroke(plot, film, robot) {
  const { left, width } = plot.bbox;
  const gradient = plot.ctx.createLinearGradient(left, 0, left + Math.max(width, 1), 0);
  let before = null;
  for (const [sample] of columnsOf(film)) {
    const now = colourOfError(film.wrongness(robot, sample));
    if (now === before) continue;
    const place = (plot.valToPos(film.ticks[sample], "x", true) - left) / width;
    const at = Number.isFinite(place) ? Math.min(Math.max(place, 0), 1) : 0;
    if (before !== null) gradient.addColorStop(at, before);
    gradient.addColorStop(at, now);
    before = now;
  }
  return gradient;
}

/** The true b of the first robot or f; null if unknown. */
function truthOf(film, symbol, sample) {
  const value = symbol === "b" ? film.value("b", 0, sample) : film.stage.fill_ratio;
  return Number.isNaN(value) ? null : value;
}

/** Lowest and highest value of some samples, in the order in which they came; null for unknown ones. */
function extremes(film, name, robot, first, end) {
  let [low, high, lowAt, highAt] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, 0, 0];
  for (let sample = first; sample < end; sample++) {
    const value = film.value(name, robot, sample);
    if (value < low) [low, lowAt] = [value, sample];
    if (value > high) [high, highAt] = [value, sample];
  }
  if (low > high) return [null, null];
  return lowAt <= highAt ? [low, high] : [high, low];
}

/** Room for all but the first moments, when estimates still jump between 0 and 1. */
function limits([, ...series]) {
  let [low, high] = [1, 0];
  for (const values of series) {
    for (let i = Math.floor(values.length / 25); i < values.length; i++) {
      if (values[i] === null) continue;
      low = Math.min(low, values[i]);
      high = Math.max(high, values[i]);
    }
  }
  if (low > high) return [0, 1];
  const margin = Math.max(0.06 * (high - low), 0.01);
  return [low - margin, high + margin];
}

/** A series of uPlot. */
function line(stroke, width, more = {}) {
  return { stroke, width, points: { show: false }, ...more };
}

export class Charts {
  constructor(parent) {
    this.parent = parent;
    this.plots = [];
    this.chosen = null;
    new ResizeObserver(() => this.#fit()).observe(parent);
  }

  show(film) {
    this.film = film;
    this.drawn = -1;
    const panels = film.comparison
      ? [ERROR, PANELS[0]]
      : film.stage.fill_ratio === null
        ? PANELS
        : [MEAN, ...PANELS];
    const isSame = film.robots === this.plots[0]?.robots && panels.length === this.plots.length;
    if (!isSame) this.rebuild(panels);
    this.update();
  }

  /** Makes all charts anew, for another number of robots or in other colours. */
  rebuild(panels = this.plots.map(({ panel }) => panel)) {
    for (const { plot } of this.plots) plot.destroy();
    this.parent.replaceChildren();
    this.plots = panels.map((panel, index) => this.#panel(panel, index === panels.length - 1));
    this.drawn = -1;
    this.#fit();
    this.update();
    this.follow(this.chosen);
  }

  #panel(panel, isLast) {
    const box = element("div", "", "chart");
    const label = element("p", panel.label);
    const truth = element("span");
    if (panel === MEAN) label.append(...this.#namesOfErrors());
    label.append(truth);
    box.append(label);
    this.parent.append(box);
    const options = this.#options(panel, isLast);
    const plot = new uPlot(options, [[0], ...options.series.slice(1).map(() => [null])], box);
    const now = element("div", "", "now");
    plot.over.append(now);
    return { plot, panel, now, truth, robots: this.film.robots };
  }

  #options(panel, isLast) {
    const axis = {
      stroke: colour("soft"),
      grid: { stroke: colour("line"), width: 1 },
      ticks: { show: false },
    };
    return {
      width: 300,
      height: 120,
      padding: [22, 26, 0, 0],
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false }, y: { range: (plot) => limits(plot.data ?? []) } },
      axes: [
        { ...axis, size: isLast ? 26 : 6, values: isLast ? undefined : () => [] },
        { ...axis, size: 46, space: 24 },
      ],
      ...(panel === ERROR
        ? this.#comparison()
        : { series: [{}, ...(panel === MEAN ? this.#meanErrors() : this.#linesOfRobots(panel))] }),
    };
  }

  /** Colour and name of this run's error and, if known, its twin's. */
  #errors() {
    const { filter, twin } = this.film.stage;
    const names = twin?.length ? [filter, "none"] : [filter];
    return names.map((name) => (name in FILTERS ? [name, FILTERS[name]] : ["ink", "these robots"]));
  }

  #namesOfErrors() {
    return this.#errors().map(([name, text]) => {
      const word = element("b", text);
      word.style.setProperty("--colour", `var(--${name})`);
      return word;
    });
  }

  #meanErrors() {
    const names = [...this.#errors(), ["none"]].slice(0, 2);
    return names.map(([name]) => line(() => colour(name), 2));
  }

  #linesOfRobots({ name }) {
    const paths = name === "b_hat" ? uPlot.paths.stepped({ align: 1 }) : undefined;
    return [
      ...this.film.stage.robots.map((_, robot) =>
        line((plot) => stroke(plot, this.film, robot), 1.2, { alpha: 0.7, paths }),
      ),
      line(colour("truth"), 1.5, { dash: [6, 4] }),
    ];
  }

  /** For each filter the median error; for the chosen one a band around it, and, thin, that of this run. */
  #comparison() {
    const names = Object.keys(FILTERS);
    const nothing = "transparent";
    const ofChosen = (name, alpha) => (name === this.film.comparison.chosen ? colour(name) + alpha : nothing);
    const lines = names.flatMap((name) => [
      line(() => colour(name), 2.2),
      line(nothing, 1),
      line(nothing, 1),
      line(() => ofChosen(name, ""), 0.7),
    ]);
    const bands = names.map((name, at) => ({
      series: [4 * at + 3, 4 * at + 2],
      fill: () => ofChosen(name, "30"),
    }));
    return { series: [{}, ...lines], bands };
  }

  #fit() {
    const height = this.parent.clientHeight - 6;
    const width = this.parent.clientWidth - 12;
    if (height <= 0 || width <= 0) return;
    const parts = this.plots.map(({ panel }) => (panel === ERROR ? 1.6 : 1));
    const whole = parts.reduce((sum, each) => sum + each, 0);
    const isLast = (index) => index === this.plots.length - 1;
    const heights = parts.map(
      (part, index) => Math.floor(((height - 20) * part) / whole) + 20 * isLast(index),
    );
    this.parent.style.gridTemplateRows = heights.map((each) => `${each}px`).join(" ");
    this.plots.forEach(({ plot }, index) => {
      plot.setSize({ width, height: heights[index] });
    });
  }

  /** The robot whose lines stand out, or null. */
  follow(robot) {
    this.chosen = robot;
    for (const { plot, panel } of this.plots) {
      if (!panel.symbol) continue;
      plot.series.slice(1, -1).forEach((series, each) => {
        series.alpha = robot === null ? 0.7 : robot === each ? 1 : 0.2;
        series.width = robot === each ? 2.6 : 1.2;
      });
      plot.redraw(false);
    }
  }

  /** Takes samples that have come since, and errors of other runs. O(samples). */
  update() {
    if (this.film?.comparison?.isNew) this.drawn = -1;
    if (!this.film || this.film.length === this.drawn || this.film.length === 0) return;
    this.drawn = this.film.length;
    for (const { plot, panel, truth } of this.plots) {
      plot.setData(panel.data ? panel.data(this.film) : thinned(this.film, panel));
      if (!panel.symbol) continue;
      const value = truthOf(this.film, panel.symbol, this.film.length - 1);
      truth.textContent = value === null ? "" : `${panel.symbol} = ${+value.toFixed(3)}`;
    }
  }

  /** Moves the line that marks the present. */
  mark(tick) {
    for (const { plot, now } of this.plots) {
      now.style.transform = `translateX(${plot.valToPos(tick, "x")}px)`;
    }
  }
}
