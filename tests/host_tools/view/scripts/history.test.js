// The history of a run: its states and its events. A test in test_scripts.py has it decode blocks of states.

import assert from "node:assert/strict";
import { test } from "node:test";
import { makeHistory, round } from "./fake_page.js";

test("the error of b_hat is its distance from b, whichever is larger", () => {
  const history = makeHistory({
    robots: [0, 1],
    ticks: [0],
    quantities: { b_hat: [0.55, 0.95], b: [0.95, 0.55] },
  });
  assert.deepEqual([round(history.bHatError(0, 0)), round(history.bHatError(1, 0))], [0.4, 0.4]);
});

test("the state at a tick is the last one that is not later", () => {
  const history = makeHistory({ robots: [0], ticks: [0, 10, 20], quantities: {} });
  const states = [0, 9, 10, 19, 20, 99].map((tick) => history.stateAt(tick));
  assert.deepEqual(states, [0, 0, 1, 1, 2, 2]);
});

test("blocks that come later are appended", () => {
  const history = makeHistory({ robots: [0], ticks: [0, 10], quantities: { b_hat: [0.1, 0.2] } });
  history.appendStates({
    ticks: Uint32Array.of(20, 30),
    columns: { b_hat: Uint16Array.of(0, 65534) },
    links: [new Uint16Array(0), new Uint16Array(0)],
  });
  assert.equal(history.lastTick, 30);
  const values = [0, 1, 2, 3].map((state) => round(history.value("b_hat", 0, state)));
  assert.deepEqual(values, [0.1, 0.2, 0, 1]);
});

test("the beginning and the end of a fault are events of the states that they come before", () => {
  const history = makeHistory({
    robots: [3],
    ticks: [0, 10, 20],
    quantities: {},
    faults: [
      ["loss=0.2", 0, null],
      ["liar", 3, 15],
    ],
  });
  assert.deepEqual(
    history.events.map(({ tick, text }) => `${tick} ${text}`),
    ["10 fault: loss=0.2", "10 fault: liar", "20 fault over: liar"],
  );
});

test("a robot that is lost, comes back and changes its b_hat makes events", () => {
  const history = makeHistory({
    robots: [3],
    ticks: [0, 10, 20, 30],
    quantities: { b_hat: [0.5, null, 0.5, 0.75], b: [0.9, 0.9, 0.9, 0.9] },
  });
  const events = history.events.map(({ tick, text, before, after }) => [
    tick,
    text ?? `${round(before)} to ${round(after)}`,
  ]);
  assert.deepEqual(events, [
    [10, "dead"],
    [20, "back"],
    [30, "0.5 to 0.75"],
  ]);
});
