// The figures, numbers and events beside the arena.

import assert from "node:assert/strict";
import { test } from "node:test";
import { colourOfError } from "view/colours";
import { formatValue, meanEstimate, showEvents, showFigures, showRobot } from "view/panels";
import { element, makeHistory } from "./fake_page.js";

/** Returns the four figures of the swarm in the first state of a history. */
function figuresOf(history) {
  showFigures(history, 0);
  return ["mean-x", "mean-error", "spread", "wrong"].map((id) => element(id).textContent);
}

test("a value has three digits, and a dash stands for what is unknown", () => {
  assert.deepEqual(
    [0.5, 0, 1, null, Number.NaN].map((value) => formatValue(value)),
    ["0.500", "0.000", "1.000", "–", "–"],
  );
});

test("the figures are mean, mean error, spread and the number of wrong robots", () => {
  const history = makeHistory({
    robots: [0, 1, 2],
    ticks: [0],
    fill_ratio: 0.5,
    quantities: { x: [0.2, 0.4, 0.9], b_hat: [0.95, 0.55, 0.9], b: [0.95, 0.95, 0.95] },
  });
  assert.deepEqual(figuresOf(history), ["0.500", "0.267", "0.700", "1 of 3"]);
});

test("a b_hat counts as wrong from an error of more than 0.1", () => {
  const history = makeHistory({
    robots: [0, 1],
    ticks: [0],
    quantities: { x: [0.5, 0.5], b_hat: [0.86, 0.84], b: [0.95, 0.95] },
  });
  assert.equal(figuresOf(history)[3], "1 of 2");
});

test("robots whose values are unknown are in no figure", () => {
  const history = makeHistory({
    robots: [0, 1, 2],
    ticks: [0],
    fill_ratio: 0.5,
    quantities: { x: [0.25, null, 0.75], b_hat: [0.95, null, 0.55], b: [0.95, 0.95, 0.95] },
  });
  assert.deepEqual(figuresOf(history), ["0.500", "0.250", "0.500", "1 of 2"]);
});

test("without any value all figures are unknown", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0],
    fill_ratio: 0.5,
    quantities: { x: [null], b_hat: [null], b: [null] },
  });
  assert.deepEqual(figuresOf(history), ["–", "–", "–", "–"]);
});

test("without the true fill ratio the mean error is unknown", () => {
  const history = makeHistory({
    robots: [0],
    ticks: [0],
    quantities: { x: [0.5], b_hat: [0.9], b: [0.9] },
  });
  assert.equal(figuresOf(history)[1], "–");
});

test("the numbers of a robot are those of the robot and the state that are shown", () => {
  element("robot").children = [element("robot-title"), element("robot-list")];
  const history = makeHistory({
    robots: [3, 8],
    ticks: [0, 10],
    flawed: [1],
    links: [1, 0],
    fill_ratio: 0.25,
    quantities: {
      x: [0.1, 0.2, 0.3, 0.4],
      x_hat: [0.5, 0.6, 0.7, 0.8],
      b_hat: [0.9, 0.91, 0.92, 0.93],
      b: [0.95, 0.95, 0.95, null],
    },
  });
  showRobot(history, 1, 1);
  assert.equal(element("robot-title").textContent, "Robot 8, flawed at the start");
  const texts = element("robot-list").children.map((cell) => cell.textContent);
  assert.deepEqual(texts, [
    ...["trusts its sensor (b_hat)", "0.9300", "true accuracy (b)", "–"],
    ...["sees by itself (x_hat)", "0.8000", "believes (x)", "0.4000"],
    ...["true share of black (f)", "0.2500", "hears", "3"],
  ]);
});

test("liars are in no mean of the estimates", () => {
  const history = makeHistory({
    robots: [0, 1, 2],
    ticks: [0],
    liars: [2],
    quantities: { x: [0.25, 0.75, 0] },
  });
  assert.equal(meanEstimate(history, 0).toFixed(3), "0.500");
});

test("events are listed with the latest first, each with the colour that its robot has from then on", () => {
  const history = makeHistory({
    robots: [3],
    ticks: [0, 10, 20],
    quantities: { b_hat: [0.55, 0.9, 0.6], b: [0.95, 0.95, 0.95] },
  });
  showEvents(history, 20, () => {});
  const [heading, list] = element("events").children;
  assert.equal(heading.textContent, "Recalibrations (b_hat): 2");
  const buttons = list.children.map((item) => item.children[0]);
  assert.deepEqual(
    buttons.map((button) => button.text),
    ["20robot 3: 0.90 → 0.60", "10robot 3: 0.55 → 0.90"],
  );
  assert.deepEqual(
    buttons.map((button) => button.children[1].style.background),
    [0.35, 0.05].map(colourOfError),
  );
});

test("a change that two digits hide has three", () => {
  const history = makeHistory({
    robots: [3],
    ticks: [0, 10],
    quantities: { b_hat: [0.551, 0.548], b: [0.95, 0.95] },
  });
  showEvents(history, 10, () => {});
  const [, list] = element("events").children;
  assert.equal(list.children[0].text, "10robot 3: 0.551 → 0.548");
});
