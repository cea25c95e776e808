// Charts over time, drawn by uPlot. Of a long history each column of the screen shows its extremes.

import { colour, colourOfError } from "view/colours";
import { createElement } from "view/panels";

const MAX_COLUMNS = 480; // of the screen, for which states are summed up
const AXIS_HEIGHT = 20; // of the lowest chart, which has the labels of the time axis

/** Returns the options of a line of uPlot. */
export function lineOptions(stroke, width, more = {}) {
  return { stroke, width, points: { show: false }, ...more };
}

/** Returns the first state of each column of the screen, and the state after its last. */
function stateRanges(history) {
  const count = Math.min(MAX_COLUMNS, history.stateCount);
  const start = (column) => Math.floor((column * history.stateCount) / count);
  return Array.from({ length: count }, (_, column) => [start(column), start(column + 1)]);
}

/** Returns the true b, of the first robot, or f in a state; null if unknown. */
function truthOf(history, symbol, state) {
  const value = symbol === "b" ? history.value("b", 0, state) : history.description.fill_ratio;
  return Number.isNaN(value) ? null : value;
}

/** Returns a robot's lowest and highest value in some states, in the order in which they came; null if unknown. */
function findExtremes(history, quantity, robot, firstState, endState) {
  let lowest = Number.POSITIVE_INFINITY;
  let highest = Number.NEGATIVE_INFINITY;
  let lowestState = 0;
  let highestState = 0;
  for (let state = firstState; state < endState; state++) {
    const value = history.value(quantity, robot, state);
    if (value < lowest) {
      lowest = value;
      lowestState = state;
    }
    if (value > highest) {
      highest = value;
      highestState = state;
    }
  }
  if (lowest > highest) return [null, null];
  return lowestState <= highestState ? [lowest, highest] : [highest, lowest];
}

/** A chart with a line for each robot, and a dashed one for the truth. */
class RobotLinesChart {
  /** Prepares the chart of a quantity; the symbol of the truth is "b" or "f". */
  constructor(history, quantity, label, symbol) {
    this.history = history;
    this.quantity = quantity;
    this.label = label;
    this.symbol = symbol;
    this.relativeHeight = 1;
    this.hasRobotLines = true;
  }

  get names() {
    return [];
  }

  get seriesOptions() {
    // b_hat keeps its value from one recalibration to the next; the others change all the time.
    const paths = this.quantity === "b_hat" ? uPlot.paths.stepped({ align: 1 }) : undefined;
    const robotLines = this.history.description.robots.map((_, robot) =>
      lineOptions((plot) => this.#createGradient(plot, robot), 1.2, { alpha: 0.7, paths }),
    );
    return { series: [{}, ...robotLines, lineOptions(colour("truth"), 1.5, { dash: [6, 4] })] };
  }

  /** Returns the colour of a robot's line, which at each time is that of the robot in the arena. */
  #createGradient(plot, robot) {
    const { history } = this;
    const { left, width } = plot.bbox;
    const gradient = plot.ctx.createLinearGradient(left, 0, left + Math.max(width, 1), 0);
    let previousColour = null;
    for (const [state] of stateRanges(history)) {
      const stateColour = colourOfError(history.bHatError(robot, state));
      if (stateColour === previousColour) continue;
      const share = (plot.valToPos(history.ticks[state], "x", true) - left) / width;
      const stop = Number.isFinite(share) ? Math.min(Math.max(share, 0), 1) : 0;
      // Two stops at the same place change the colour at once.
      if (previousColour !== null) gradient.addColorStop(stop, previousColour);
      gradient.addColorStop(stop, stateColour);
      previousColour = stateColour;
    }
    return gradient;
  }

  /** Returns uPlot's data, two points for each column of the screen: ticks, each robot's values, the truth. */
  computeData() {
    const { history, quantity, symbol } = this;
    const ranges = stateRanges(history);
    const ticks = ranges.flatMap(([first, end]) => {
      const isOneState = end - first === 1;
      // uPlot needs ticks that rise, also where both points are of the same state.
      return [history.ticks[first], history.ticks[end - 1] + (isOneState ? 1e-6 : 0)];
    });
    const valuesByRobot = history.description.robots.map((_, robot) =>
      ranges.flatMap(([first, end]) => findExtremes(history, quantity, robot, first, end)),
    );
    const truths = ranges.flatMap(([first]) => {
      const truth = truthOf(history, symbol, first);
      return [truth, truth];
    });
    return [ticks, ...valuesByRobot, truths];
  }
}

/** A chart of the robots' mean error of x and, if known, that of the same robots without a filter. */
class MeanErrorChart {
  constructor(history) {
    this.history = history;
    this.label = "mean error of what they believe:";
    this.relativeHeight = 1;
    this.hasRobotLines = false;
  }

  /** The colour and the text of each line, for the label. A filter's colour has the filter's name. */
  get names() {
    const { filter, filter_term: term, unfiltered_errors: unfilteredErrors } = this.history.description;
    const ownName = filter === null ? ["ink", "these robots"] : [filter, term];
    return unfilteredErrors.length > 0 ? [ownName, ["none", "no filter"]] : [ownName];
  }

  get seriesOptions() {
    const [[ownColour], [otherColour] = ["none"]] = this.names;
    const lines = [ownColour, otherColour].map((name) => lineOptions(() => colour(name), 2));
    return { series: [{}, ...lines] };
  }

  /** Returns uPlot's data: ticks, mean errors, and mean errors without a filter. O(states robots). */
  computeData() {
    const { history } = this;
    const ranges = stateRanges(history);
    const ticks = ranges.map(([first]) => history.ticks[first]);
    const errors = ranges.map(([first, end]) => this.#computeMeanError(first, end));
    const unfilteredErrors = ticks.map((tick) => this.#unfilteredErrorAt(tick));
    return [ticks, errors, unfilteredErrors];
  }

  /** Returns the mean of |x - f| over robots and states; null if all x are unknown. */
  #computeMeanError(firstState, endState) {
    const { history } = this;
    let sum = 0;
    let count = 0;
    for (let state = firstState; state < endState; state++) {
      for (let robot = 0; robot < history.robotCount; robot++) {
        const x = history.value("x", robot, state);
        if (Number.isNaN(x)) continue;
        sum += Math.abs(x - history.description.fill_ratio);
        count++;
      }
    }
    return count === 0 ? null : sum / count;
  }

  /** Returns the mean error without a filter at a tick; null if unknown. */
  #unfilteredErrorAt(tick) {
    const { unfiltered_errors: errors, steps } = this.history.description;
    const index = Math.floor((tick * errors.length) / (steps + 1));
    return errors[Math.min(index, errors.length - 1)] ?? null;
  }
}

/** Returns the charts of a history, from top to bottom. */
export function chartsOf(history) {
  const charts = [
    new RobotLinesChart(history, "b_hat", "trust in its sensor (b_hat)", "b"),
    new RobotLinesChart(history, "x_hat", "what each sees by itself (x_hat)", "f"),
    new RobotLinesChart(history, "x", "what each believes after hearing others (x)", "f"),
  ];
  const isTruthKnown = history.description.fill_ratio !== null;
  return isTruthKnown ? [new MeanErrorChart(history), ...charts] : charts;
}

/** Returns the limits of a chart's y axis: all values but the first ones, which still jump between 0 and 1. */
function computeLimits([, ...series]) {
  let lowest = 1;
  let highest = 0;
  for (const values of series) {
    for (let index = Math.floor(values.length / 25); index < values.length; index++) {
      if (values[index] === null) continue;
      lowest = Math.min(lowest, values[index]);
      highest = Math.max(highest, values[index]);
    }
  }
  if (lowest > highest) return [0, 1];
  const margin = Math.max(0.06 * (highest - lowest), 0.01);
  return [lowest - margin, highest + margin];
}

/**
 * The charts of a page, one below the other.
 *
 * A chart has a label, `names` (colours and texts in the label), `relativeHeight`, `seriesOptions` and
 * `computeData()` for uPlot, and, if `hasRobotLines`, a `history` and the `symbol` of the truth.
 */
export class Charts {
  constructor(parent) {
    this.parent = parent;
    this.views = []; // of each chart: the chart, uPlot's plot, and the elements that change
    this.followedRobot = null;
    this.drawnStateCount = 0;
    this.presentTick = 0;
    new ResizeObserver(() => this.#fitToParent()).observe(parent);
  }

  /** Replaces all charts by those of another history. */
  show(history, charts) {
    this.history = history;
    this.#createViews(charts);
  }

  /** Makes all charts anew, in new colours. */
  recolour() {
    this.#createViews(this.views.map(({ chart }) => chart));
  }

  #createViews(charts) {
    for (const { plot } of this.views) plot.destroy();
    this.parent.replaceChildren();
    this.views = charts.map((chart, index) => this.#createView(chart, index === charts.length - 1));
    this.#fitToParent();
    this.invalidate();
    this.update();
    this.follow(this.followedRobot);
  }

  #createView(chart, isLast) {
    const box = createElement("div", "", "chart");
    const label = createElement("p", chart.label);
    for (const [colourName, text] of chart.names) {
      const name = createElement("b", text);
      name.style.setProperty("--colour", `var(--${colourName})`);
      label.append(name);
    }
    const truth = createElement("span");
    label.append(truth);
    box.append(label);
    this.parent.append(box);
    const options = this.#plotOptions(chart, isLast);
    const emptyData = [[0], ...options.series.slice(1).map(() => [null])];
    const plot = new uPlot(options, emptyData, box);
    plot.over.append(createElement("div", "", "now"));
    return { chart, plot, truth };
  }

  /** Returns uPlot's options of a chart; only the last one has the labels of the time axis. */
  #plotOptions(chart, isLast) {
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
      hooks: { draw: [(drawn) => this.#placePresentLine(drawn)] },
      scales: { x: { time: false }, y: { range: (plot) => computeLimits(plot.data ?? []) } },
      axes: [
        { ...axis, size: isLast ? 26 : 6, values: isLast ? undefined : () => [] },
        { ...axis, size: 46, space: 24 },
      ],
      ...chart.seriesOptions,
    };
  }

  /** Shares the parent's height among the charts; the last one gets the height of the axis in addition. */
  #fitToParent() {
    const height = this.parent.clientHeight - 6;
    const width = this.parent.clientWidth - 12;
    if (height <= 0 || width <= 0) return;
    const totalShares = this.views.reduce((sum, { chart }) => sum + chart.relativeHeight, 0);
    const heights = this.views.map(({ chart }, index) => {
      const ownHeight = Math.floor(((height - AXIS_HEIGHT) * chart.relativeHeight) / totalShares);
      return index === this.views.length - 1 ? ownHeight + AXIS_HEIGHT : ownHeight;
    });
    this.parent.style.gridTemplateRows = heights.map((pixels) => `${pixels}px`).join(" ");
    this.views.forEach(({ plot }, index) => {
      plot.setSize({ width, height: heights[index] });
    });
  }

  /** Makes the lines of a robot stand out, or of none if it is null. */
  follow(robot) {
    this.followedRobot = robot;
    for (const { chart, plot } of this.views) {
      if (!chart.hasRobotLines) continue;
      const robotLines = plot.series.slice(1, -1); // between the ticks and the truth
      robotLines.forEach((line, lineRobot) => {
        const isFollowed = lineRobot === robot;
        const fadedAlpha = robot === null ? 0.7 : 0.2;
        line.alpha = isFollowed ? 1 : fadedAlpha;
        line.width = isFollowed ? 2.6 : 1.2;
      });
      plot.redraw(false);
    }
  }

  /** Makes the next `update` draw, although no states have come. */
  invalidate() {
    this.drawnStateCount = -1;
  }

  /** Draws all charts again if states have come since the last time. O(states robots). */
  update() {
    const stateCount = this.history?.stateCount ?? 0;
    if (stateCount === 0 || stateCount === this.drawnStateCount) return;
    this.drawnStateCount = stateCount;
    for (const { chart, plot, truth } of this.views) {
      plot.setData(chart.computeData());
      if (!chart.hasRobotLines) continue;
      const value = truthOf(this.history, chart.symbol, stateCount - 1);
      truth.textContent = value === null ? "" : `${chart.symbol} = ${+value.toFixed(3)}`;
    }
  }

  /** Moves the line that marks the present to a tick. */
  markPresent(tick) {
    this.presentTick = tick;
    for (const { plot } of this.views) this.#placePresentLine(plot);
  }

  /** Moves the line of one chart, also when its scale has changed. */
  #placePresentLine(plot) {
    const line = plot.over.querySelector(".now");
    if (line !== null) line.style.transform = `translateX(${plot.valToPos(this.presentTick, "x")}px)`;
  }
}
