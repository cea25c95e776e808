// The charts over time: the numbers that they draw.

import assert from "node:assert/strict";
import { test } from "node:test";
import { chartsOf } from "view/charts";
import { makeHistory, round } from "./fake_page.js";

/** Returns the data of a history's charts: mean error, b_hat, x_hat, x; without f there is no mean error. */
function dataOf(history) {
  return chartsOf(history).map((chart) => chart.computeData().map((series) => Array.from(series, round)));
}

test("lines have each state of a short run twice, and the dashed one is the truth", () => {
  const history = makeHistory({
    robots: [3, 8],
    ticks: [0, 10],
    quantities: {
      b_hat: [0.55, 0.95, 0.65, 0.95],
      x_hat: [0.1, 0.2, 0.3, 0.4],
      x: [0.5, 0.6, 0.7, null],
      b: [0.9, 0.9, 0.9, 0.9],
    },
  });
  const ticks = [0, 0, 10, 10];
  const unknown = [null, null, null, null];
  assert.deepEqual(dataOf(history), [
    [ticks, [0.55, 0.55, 0.65, 0.65], [0.95, 0.95, 0.95, 0.95], [0.9, 0.9, 0.9, 0.9]],
    [ticks, [0.1, 0.1, 0.3, 0.3], [0.2, 0.2, 0.4, 0.4], unknown],
    [ticks, [0.5, 0.5, 0.7, 0.7], [0.6, 0.6, null, null], unknown],
  ]);
});

test("ticks of a line rise, also within a state", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0, 10],
    quantities: {},
  });
  const [ticks] = chartsOf(history)[0].computeData();
  assert.deepEqual(ticks, [0, 1e-6, 10, 10 + 1e-6]);
});

test("the truth about x_hat and x is the fill ratio", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0],
    fill_ratio: 0.75,
    quantities: { b: [0.9] },
  });
  const truths = dataOf(history).map((series) => series.at(-1)[0]);
  assert.deepEqual(truths.slice(1), [0.9, 0.75, 0.75]);
});

test("a truth that is unknown has no line", () => {
  const history = makeHistory({ robots: [0], ticks: [0], quantities: {} });
  const truths = dataOf(history).map((series) => series.at(-1)[0]);
  assert.deepEqual(truths, [null, null, null]);
});

test("a column of a long run has its extremes, in the order in which they came", () => {
  // 960 states are 480 columns of two.
  const states = Array.from({ length: 960 }, (_, state) => state);
  const x = states.map((state) => [0.25, 0.75, 0.5, 0.125][state % 4]);
  const history = makeHistory({
    robots: [0],
    ticks: states,
    quantities: { x },
  });
  const [ticks, values] = dataOf(history)[2];
  assert.equal(values.length, 960);
  assert.deepEqual(ticks.slice(0, 4), [0, 1, 2, 3]);
  assert.deepEqual(values.slice(0, 4), [0.25, 0.75, 0.5, 0.125]);
});

test("the mean error is that of all robots whose x is known", () => {
  const history = makeHistory({
    robots: [0, 1, 2],
    ticks: [0, 10, 20],
    fill_ratio: 0.5,
    quantities: { x: [0.25, 0.75, 1, 0.5, 0.5, null, null, null, null] },
  });
  const [ticks, errors, unfilteredErrors] = dataOf(history)[0];
  assert.deepEqual(ticks, [0, 10, 20]);
  assert.deepEqual(errors, [0.3333, 0, null]);
  assert.deepEqual(unfilteredErrors, [null, null, null]);
});

test("the mean error of a column of a long run is that of all its states", () => {
  const states = Array.from({ length: 960 }, (_, state) => state);
  const x = states.map((state) => (state % 2 === 0 ? 0.5 : 1));
  const history = makeHistory({
    robots: [0],
    ticks: states,
    fill_ratio: 0.5,
    quantities: { x },
  });
  const [, errors] = dataOf(history)[0];
  assert.deepEqual(errors, new Array(480).fill(0.25));
});

/** Returns the colours and texts in the label of the mean error's chart; further fields are of a description. */
function namesOfErrors(fields) {
  const history = makeHistory({ robots: [0], ticks: [0], fill_ratio: 0.5, quantities: {}, ...fields });
  return chartsOf(history)[0].names;
}

test("the mean error has the name of the filter and, if it is drawn, that of no filter", () => {
  const filter = { filter: "asdf-plus", filter_term: "ASDF+" };
  assert.deepEqual(namesOfErrors({}), [["ink", "these robots"]]);
  assert.deepEqual(namesOfErrors(filter), [["asdf-plus", "ASDF+"]]);
  assert.deepEqual(namesOfErrors({ ...filter, unfiltered_errors: [0.4] }), [
    ["asdf-plus", "ASDF+"],
    ["none", "no filter"],
  ]);
});

test("the errors without a filter are spread over the run", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0, 5, 10, 19],
    steps: 19,
    fill_ratio: 0.5,
    unfiltered_errors: [0.4, 0.3],
    quantities: {},
  });
  const [, , unfilteredErrors] = dataOf(history)[0];
  assert.deepEqual(unfilteredErrors, [0.4, 0.4, 0.3, 0.3]);
});

test("without the fill ratio there is no chart of the mean error", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0],
    quantities: {},
  });
  const symbols = chartsOf(history).map(({ label }) => /\((.*)\)/.exec(label)[1]);
  assert.deepEqual(symbols, ["b_hat", "x_hat", "x"]);
});
