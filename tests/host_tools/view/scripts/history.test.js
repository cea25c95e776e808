// The history of a run: what its 16-bit numbers, its links and its blocks of bytes stand for.

import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { History } from "view/history";
import { makeHistory, round } from "./fake_page.js";

const DESCRIPTION = {
  robots: [3, 8],
  flawed: [],
  quantities: ["b_hat"],
  fill_ratio: null,
  steps: 20,
  sides: null,
  floor: null,
};

/** Returns bytes as a block of states has them: deflated, in base64. */
function compress(...arrays) {
  const bytes = Buffer.concat(arrays.map(({ buffer }) => Buffer.from(buffer)));
  return deflateSync(bytes).toString("base64");
}

test("a value is between 0 and 1, and what is unknown is NaN", () => {
  const history = makeHistory({ robots: [0, 1, 2, 3], ticks: [0], quantities: { x: [0, 0.25, 1, null] } });
  assert.deepEqual(
    [0, 1, 2, 3].map((robot) => round(history.value("x", robot, 0))),
    [0, 0.25, 1, Number.NaN],
  );
});

test("the error of b_hat is its distance from b, whichever is larger", () => {
  const history = makeHistory({
    robots: [0, 1],
    ticks: [0],
    quantities: { b_hat: [0.55, 0.95], b: [0.95, 0.55] },
  });
  assert.deepEqual([round(history.bHatError(0, 0)), round(history.bHatError(1, 0))], [0.4, 0.4]);
});

test("a block has ticks, differences of each robot's values, and a bit for each link", async () => {
  const history = new History(DESCRIPTION);
  const ticks = Uint32Array.of(10, 20);
  const robot3 = [32767, 1]; // 0.5, then one more
  const robot8 = [65534, 1]; // 1, then unknown
  const links = Uint8Array.of(0b0010, 0b0100);
  const data = compress(ticks, Uint16Array.of(...robot3, ...robot8), links);
  await history.appendBlock({ count: 2, data });
  assert.deepEqual([...history.ticks], [10, 20]);
  assert.deepEqual([...history.columns.b_hat], [32767, 65534, 32768, 65535]);
  assert.deepEqual([history.links(0), history.links(1)], [[[1, 0]], [[0, 1]]]);
});

test("links of more than 128 robots are pairs of receiver and sender", async () => {
  const robots = Array.from({ length: 129 }, (_, robot) => robot);
  const history = new History({ ...DESCRIPTION, robots, quantities: [] });
  const pairs = Uint16Array.of(5, 128, 5, 7, 6, 0);
  const data = compress(Uint32Array.of(10), Uint32Array.of(3), pairs);
  await history.appendBlock({ count: 1, data });
  assert.deepEqual(history.links(0), [
    [128, 5],
    [7, 5],
    [0, 6],
  ]);
  assert.deepEqual(history.links(0, 6), [[0, 6]]);
});

test("a position is in metres from the middle of the arena", () => {
  const history = new History({ ...DESCRIPTION, robots: [0], quantities: [], sides: [2, 4] });
  history.appendStates({
    ticks: Uint32Array.of(0),
    columns: { position_x: Uint16Array.of(65534), position_y: Uint16Array.of(0) },
    links: Uint8Array.of(0),
  });
  assert.deepEqual(history.position(0, 0), [1, -2]);
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
    links: new Uint8Array(2),
  });
  assert.equal(history.lastTick, 30);
  const values = [0, 1, 2, 3].map((state) => round(history.value("b_hat", 0, state)));
  assert.deepEqual(values, [0.1, 0.2, 0, 1]);
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
