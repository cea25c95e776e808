// Charts of all robots over time. Long films are thinned to the extremes of each column of the screen.

import { colour, colourOfError } from "view/colours";
import { COLOURS, FILTERS } from "view/playground";

const COLUMNS = 480;
const MEAN = { name: "mean error", label: "mean error of x: " };
const ERROR = { name: "error", label: "mean error of x: median and middle half of runs" };
const PANELS = [
  { name: "b_hat", label: "b_hat: trust in the own sensor", symbol: "b" },
  { name: "x_hat", label: "x_hat: what each sees by itself", symbol: "f" },
  { name: "x", label: "x: what each believes after hearing its neighbours", symbol: "f" },
];

/** Smallest and largest value of each column, as data for uPlot: ticks, a row per robot, then the truth. */
function thinned(film, { name, symbol }) {
  const columns = Math.min(COLUMNS, film.length);
  const ticks = new Float64Array(2 * columns);
  const series = film.stage.robots.map(() => new Array(2 * columns));
  const truths = new Array(2 * columns);
  for (let column = 0; column < columns; column++) {
    const first = Math.floor((column * film.length) / columns);
    const end = Math.max(first + 1, Math.floor(((column + 1) * film.length) / columns));
    ticks[2 * column] = film.ticks[first];
    ticks[2 * column + 1] = film.ticks[end - 1] + (end - first === 1 ? 1e-6 : 0);
    truths[2 * column] = truths[2 * column + 1] = truthOf(film, symbol, first);
    series.forEach((values, robot) => {
      const [low, high, lowFirst] = extremes(film, name, robot, first, end);
      values[2 * column] = lowFirst ? low : high;
      values[2 * column + 1] = lowFirst ? high : low;
    });
  }
  return [ticks, ...series, truths];
}

/** Mean error of x over time, and that of the twin without a filter, as data for uPlot. O(samples robots). */
function meanErrors(film) {
  const { fill_ratio: f, twin = [], steps } = film.stage;
  const columns = Math.min(COLUMNS, film.length);
  const rows = [[], [], []];
  for (let column = 0; column < columns; column++) {
    const first = Math.floor((column * film.length) / columns);
    const end = Math.max(first + 1, Math.floor(((column + 1) * film.length) / columns));
    let [sum, count] = [0, 0];
    for (let at = first * film.robots; at < end * film.robots; at++) {
      const x = film.value("x", at % film.robots, Math.floor(at / film.robots));
      if (!Number.isNaN(x)) [sum, count] = [sum + Math.abs(x - f), count + 1];
    }
    const tick = film.ticks[first];
    rows[0].push(tick);
    rows[1].push(count ? sum / count : null);
    rows[2].push(twin[Math.min(Math.floor((tick * twin.length) / (steps + 1)), twin.length - 1)] ?? null);
  }
  return rows;
}

/** The colour of a robot's line: at each time that of the robot on the floor. */
function stroke(plot, film, robot) {
  const { left, width } = plot.bbox;
  const gradient = plot.ctx.createLinearGradient(left, 0, left + Math.max(width, 1), 0);
  let before = null;
  const columns = Math.min(COLUMNS, film.length);
  for (let column = 0; column < columns; column++) {
    const sample = Math.floor((column * film.length) / columns);
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

/** Lowest and highest value of some samples, and whether the lowest came first; null for unknown ones. */
function extremes(film, name, robot, first, end) {
  let [low, high, lowAt, highAt] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, 0, 0];
  for (let sample = first; sample < end; sample++) {
    const value = film.value(name, robot, sample);
    if (value < low) [low, lowAt] = [value, sample];
    if (value > high) [high, highAt] = [value, sample];
  }
  return low > high ? [null, null, true] : [low, high, lowAt <= highAt];
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
    const box = document.createElement("div");
    box.className = "chart";
    const label = document.createElement("p");
    label.textContent = panel.label;
    if (panel === MEAN) label.append(...this.#namesOfErrors());
    const truth = document.createElement("span");
    label.append(truth);
    box.append(label);
    this.parent.append(box);
    const options = this.#options(panel, isLast);
    const plot = new uPlot(options, [[0], ...options.series.slice(1).map(() => [null])], box);
    const now = document.createElement("div");
    now.className = "now";
    plot.over.append(now);
    return { plot, panel, now, truth, robots: this.film.robots };
  }

  #options(panel, isLast) {
    const axis = {
      stroke: colour("soft"),
      grid: { stroke: colour("line"), width: 1 },
      ticks: { show: false },
    };
    const isStepped = panel.name === "b_hat";
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
        : { series: panel === MEAN ? this.#meanErrors() : this.#seriesOfRobots(isStepped) }),
    };
  }

  /** Colour and name of this run's error and, if known, its twin's. */
  #errors() {
    const { filter, twin } = this.film.stage;
    const names = twin?.length ? [filter, "none"] : [filter];
    return names.map((name) => [COLOURS[name] ?? "ink", FILTERS[name] ?? "these robots"]);
  }

  #namesOfErrors() {
    return this.#errors().map(([name, text]) => {
      const word = document.createElement("b");
      word.textContent = text;
      word.style.setProperty("--colour", `var(--${name})`);
      return word;
    });
  }

  #meanErrors() {
    const lines = [...this.#errors(), ["none"]].slice(0, 2);
    return [
      {},
      ...lines.map(([name]) => ({ stroke: () => colour(name), width: 2, points: { show: false } })),
    ];
  }

  #seriesOfRobots(isStepped) {
    return [
      {},
      ...this.film.stage.robots.map((_, robot) => ({
        stroke: (plot) => stroke(plot, this.film, robot),
        alpha: 0.7,
        width: 1.2,
        points: { show: false },
        paths: isStepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
      })),
      { stroke: colour("truth"), width: 1.5, dash: [6, 4], points: { show: false } },
    ];
  }

  /** For each filter the median error; for the chosen one a band around it, and, thin, that of this run. */
  #comparison() {
    const { filters } = this.film.comparison;
    const isChosen = (each) => each.name === this.film.comparison.chosen;
    const nothing = "transparent";
    const line = (each, width, isShown) => ({
      stroke: () => (isShown(each) ? colour(each.colour) : nothing),
      width,
      points: { show: false },
    });
    const never = () => false;
    return {
      series: [
        {},
        ...filters.flatMap((each) => [
          line(each, 2.2, () => true),
          line(each, 1, never),
          line(each, 1, never),
          line(each, 0.7, isChosen),
        ]),
      ],
      bands: filters.map((each, at) => ({
        series: [4 * at + 3, 4 * at + 2],
        fill: () => (isChosen(each) ? `${colour(each.colour)}30` : nothing),
      })),
    };
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
      if (panel === ERROR) {
        plot.setData(this.film.comparison.data());
        continue;
      }
      if (panel === MEAN) {
        plot.setData(meanErrors(this.film));
        continue;
      }
      plot.setData(thinned(this.film, panel));
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
