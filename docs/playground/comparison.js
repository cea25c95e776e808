// The comparison of all filters: errors of many trials, and the chart of their medians and quartiles.

import { FILTERS } from "playground/settings";
import { lineOptions } from "view/charts";
import { colour } from "view/colours";

const SAMPLES_PER_POINT = 8; // of an error's line
const POINTS = 100; // of a whole: errors are shown in percentage points

/** Returns the median, the lower and the upper quartile of series at each point. */
export function computeQuartiles(series) {
  const sortedByPoint = Array.from(series[0], (_, point) =>
    Float64Array.from(series, (values) => values[point]).sort(),
  );
  const quantile = (share) => sortedByPoint.map((values) => values[Math.round(share * (values.length - 1))]);
  return [quantile(0.5), quantile(0.25), quantile(0.75)];
}

/**
 * Returns the mean of each block of SAMPLES_PER_POINT values. This smooths the line: x jumps from step to step,
 * as neighbours come and go.
 */
export function averageBlocks(values) {
  const blockCount = Math.floor(values.length / SAMPLES_PER_POINT) || 1;
  return Float64Array.from({ length: blockCount }, (_, block) => {
    const start = block * SAMPLES_PER_POINT;
    const blockValues = values.subarray(start, start + SAMPLES_PER_POINT);
    return blockValues.reduce((sum, value) => sum + value, 0) / blockValues.length;
  });
}

/** Returns an error in percentage points; null if it is undefined. */
function toPoints(error) {
  return error === undefined ? null : POINTS * error;
}

/** The errors of all filters in all trials so far, and the chart that shows them. */
export class Comparison {
  /** Creates a comparison without errors of `trialCount` trials; samples are `interval` steps apart. */
  constructor(interval, trialCount) {
    this.interval = interval;
    this.trialCount = trialCount;
    this.chosenFilter = null;
    this.filters = Object.keys(FILTERS).map((name) => ({ name, trials: [] }));
    this.label = "points off per robot: median, middle half of runs";
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
    // A median of few trials may mislead, and so is pale.
    const alpha = (name) => (this.finalError(name)?.trialCount === this.trialCount ? "" : "48");
    const lines = this.filters.flatMap(({ name }) => [
      lineOptions(() => colour(name) + alpha(name), 2.2),
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
      const lines = [...computeQuartiles(knownTrials), trials[0] ?? []];
      return lines.map((errors) => Array.from(unknown, (_, point) => toPoints(errors[point])));
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

  /** Returns `finalError` as texts: the error in points, its runs, and whether all of them are in. */
  describeFinalError(filterName) {
    const { trialCount } = this;
    const finalError = this.finalError(filterName);
    if (finalError === null) return { value: "…", runs: `0 of ${trialCount} runs`, isComplete: false };
    const isComplete = finalError.trialCount === trialCount;
    return {
      value: toPoints(finalError.median).toFixed(1),
      runs: isComplete ? `${trialCount} runs` : `${finalError.trialCount} of ${trialCount} runs`,
      isComplete,
    };
  }
}
