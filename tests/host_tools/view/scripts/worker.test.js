// The worker of the playground: what it makes of the numbers that the compiled firmware and engine write.

import assert from "node:assert/strict";
import { test } from "node:test";
import { encode, round } from "./fake_page.js";

const JOB = {
  seed: 7,
  robots: 2,
  flawedCount: 1,
  liars: 0,
  density: 4,
  fill: 0.3,
  wrong: 0.55,
  accuracy: 0.95,
  steps: 10,
  interval: 10,
  trials: 1,
  filter: "robust",
};

/** Places of arrays in the engine's memory. Each array has the 256 bytes up to the next one. */
const PLACES = { settings: 0, errors: 256, records: 512, links: 768, positions: 1024, pixels: 1280 };

/** Returns what playground.c exports, with a memory that holds a trial of two robots and one recorded step. */
function makeEngine() {
  const memory = { buffer: new ArrayBuffer(2048) };
  const write = (ArrayType, name, values) => new ArrayType(memory.buffer, PLACES[name]).set(values);
  // A record has ten words: x_hat is the fifth, x the eighth and b_hat the ninth.
  write(Uint32Array, "records", [
    ...[0, 0, 0, 0, 2 ** 21, 0, 0, 2 ** 22, 3 * 2 ** 30, 0],
    ...[0, 0, 0, 0, 2 ** 23, 0, 0, 0, 2 ** 31, 0],
  ]);
  write(Float64Array, "errors", [0.05, 0.3]);
  write(Uint8Array, "links", [0b0010, 0b0100]); // bit 2 * receiver + sender of each sample
  // x and y of robots 0 and 1 in each sample, in metres from the middle
  write(Float64Array, "positions", [-2, 2, 0, 1, 2, -2, 0, 1]);
  const places = Object.entries(PLACES).map(([name, value]) => [name, { value }]);
  return {
    ...Object.fromEntries(places),
    memory,
    run_trial: () => 0,
    record_motion: () => 8,
    arena_side: () => 4,
  };
}

const engine = makeEngine();
let handleMessage; // by the worker, which imports nothing and is told what to do by messages
let receiveResult;
globalThis.addEventListener = (_, handler) => {
  handleMessage = handler;
};
globalThis.postMessage = (result) => receiveResult(result);
WebAssembly.instantiate = async () => ({ instance: { exports: engine } });
await import("playground/worker");
await handleMessage({ data: { module: "the compiled program" } });

/** Returns the results of a job: one of each filter and trial. */
async function resultsOf(job) {
  const results = [];
  const areAllReceived = new Promise((resolve) => {
    receiveResult = (result) => {
      results.push(result);
      if (results.length === 4 * job.trials) resolve();
    };
  });
  handleMessage({ data: job });
  await areAllReceived;
  return results;
}

test("the settings of a job are written in the order of settings_t in playground.c", async () => {
  await resultsOf(JOB);
  const { buffer } = engine.memory;
  assert.deepEqual(Array.from(new Float64Array(buffer, PLACES.settings, 4)), [0.3, 0.95, 0.55, 4]);
  assert.deepEqual(Array.from(new Uint32Array(buffer, PLACES.settings + 32, 6)), [7, 2, 1, 0, 10, 10]);
});

test("a run begins with what robots assume, and goes on with x, x_hat and b_hat of the records", async () => {
  const [{ run }] = await resultsOf(JOB);
  assert.deepEqual([...run.ticks], [0, 10]);
  const { x, x_hat, b_hat, b } = run.columns;
  assert.deepEqual(x, encode([0.5, 0.5, 0.5, 0]));
  assert.deepEqual(x_hat, encode([0.5, 0.5, 0.25, 1]));
  assert.deepEqual(b_hat, encode([0.55, 0.95, 0.75, 0.5]));
  assert.deepEqual(b, encode([0.95, 0.95, 0.95, 0.95]));
});

test("a run has the places of robots as shares of the arena, and receiver and sender of each link", async () => {
  const [{ run }] = await resultsOf(JOB);
  assert.deepEqual(run.sides, [4, 4]);
  assert.deepEqual(run.columns.position_x, encode([0, 0.5, 1, 0.5]));
  assert.deepEqual(run.columns.position_y, encode([1, 0.75, 0, 0.75]));
  assert.deepEqual(
    run.links.map((links) => Array.from(links)),
    [
      [0, 1],
      [1, 0],
    ],
  );
});

test("robots that all receive from each other have links and no places", async () => {
  const [{ run }] = await resultsOf({ ...JOB, everybody: 1 });
  assert.equal(run.sides, null);
  assert.deepEqual(Array.from(run.links[1]), [0, 1, 1, 0]);
});

test("each filter runs each trial once; those of the large figures come first", async () => {
  const results = await resultsOf({ ...JOB, trials: 2 });
  assert.deepEqual(
    results.map(({ filter, trial }) => `${filter} ${trial}`),
    [
      ...["robust 0", "none 0", "none 1", "robust 1"],
      ...["asdf-minus 0", "asdf-plus 0", "asdf-minus 1", "asdf-plus 1"],
    ],
  );
  assert.deepEqual(Array.from(results[3].errors, round), [0.05, 0.3]);
});
