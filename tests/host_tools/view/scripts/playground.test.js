// The playground: its settings as addresses and commands, and the errors of many trials.

import assert from "node:assert/strict";
import { test } from "node:test";
import { averageBlocks, Comparison, computeQuartiles } from "playground/comparison";
import {
  AddressFormat,
  addLiar,
  describeRun,
  formatCommand,
  limitLiars,
  makeJob,
  miscalibrateMore,
} from "playground/settings";
import "./fake_page.js";

const LIMITS = [
  { name: "robots", minimum: 2, maximum: 127, defaultValue: 20 },
  { name: "flawed", minimum: 0, maximum: 100, defaultValue: 50 },
  { name: "liars", minimum: 0, maximum: 10, defaultValue: 0 },
  { name: "seed", minimum: 0, maximum: 99, defaultValue: 1 },
  { name: "everybody", minimum: 0, maximum: 1, defaultValue: 0 },
  { name: "steps", minimum: 0, maximum: 1000, defaultValue: 0 },
];
const SETTINGS = {
  robots: 20,
  flawed: 30,
  liars: 0,
  seed: 7,
  everybody: 0,
  steps: 0,
  density: 4,
  fill: 0.55,
  wrong: 0.55,
  accuracy: 0.95,
  filter: "robust",
};

test("the quartiles of five trials are the third, the second and the fourth in order", () => {
  const trials = [5, 1, 4, 2, 3].map((value) => Float64Array.of(value, 10 * value));
  assert.deepEqual(computeQuartiles(trials), [
    [3, 30],
    [2, 20],
    [4, 40],
  ]);
});

test("a point of a line is the mean of eight samples", () => {
  const samples = Float64Array.of(...new Array(8).fill(0.5), 0, 0, 0, 0, 1, 1, 1, 1);
  assert.deepEqual([...averageBlocks(samples)], [0.5, 0.5]);
});

test("a run of fewer than eight samples is one point", () => {
  assert.deepEqual([...averageBlocks(Float64Array.of(0.25, 0.75))], [0.5]);
});

test("the error at the end is the median of the trials that are known", () => {
  const comparison = new Comparison(1, 30);
  [0.3, 0.1, 0.2].forEach((error, trial) => {
    const errors = Float64Array.of(...new Array(8).fill(1), ...new Array(8).fill(error));
    comparison.addErrors("robust", trial + 1, errors); // trial 0 is not there yet
  });
  const { median, trialCount } = comparison.finalError("robust");
  assert.deepEqual([median.toFixed(3), trialCount], ["0.200", 3]);
});

test("the error of a filter without trials is unknown", () => {
  assert.equal(new Comparison(1, 30).finalError("none"), null);
});

test("an error at the end is in points, and unfinished until all runs are in", () => {
  const comparison = new Comparison(1, 2);
  const texts = [0, 1].map((trial) => {
    const before = Object.values(comparison.describeFinalError("robust"));
    comparison.addErrors("robust", trial, Float64Array.of(0.0386));
    return before;
  });
  assert.deepEqual(
    [...texts, Object.values(comparison.describeFinalError("robust"))],
    [
      ["…", "0 of 2 runs", false],
      ["3.9", "1 of 2 runs", false],
      ["3.9", "2 runs", true],
    ],
  );
});

test("the median of a filter is pale until all runs are in", () => {
  const comparison = new Comparison(1, 2);
  const strokes = [0, 1].map((trial) => {
    comparison.addErrors("none", trial, Float64Array.of(0.1));
    return comparison.seriesOptions.series[1].stroke();
  });
  assert.deepEqual(strokes, ["#7a869448", "#7a8694"]);
});

test("the chart has median, quartiles and the first trial of each filter in points, at the middles of the points", () => {
  const comparison = new Comparison(10, 30);
  [0.01, 0.02, 0.03, 0.04, 0.05].forEach((error, trial) => {
    comparison.addErrors("none", trial, new Float64Array(16).fill(error));
  });
  const [ticks, median, lower, upper, first, ...others] = comparison.computeData();
  assert.deepEqual(ticks, [40, 120]);
  assert.deepEqual(
    [median, lower, upper, first],
    [
      [3, 3],
      [2, 2],
      [4, 4],
      [1, 1],
    ],
  );
  assert.deepEqual(others, new Array(12).fill([null, null]));
});

test("the chart has no first trial of a filter before it is there", () => {
  const comparison = new Comparison(1, 30);
  comparison.addErrors("none", 1, new Float64Array(8).fill(0.01));
  const [, median, , , first] = comparison.computeData();
  assert.deepEqual([median, first], [[1], [null]]);
});

test("an address has the settings that are not defaults", () => {
  const format = new AddressFormat(LIMITS);
  const settings = format.parse("#robots=9&filter=robust");
  assert.equal(settings.robots, 9);
  assert.equal(settings.flawed, 50);
  assert.equal(format.format(settings), "#robots=9&filter=robust");
});

test("settings that are out of range or no numbers have their defaults", () => {
  const settings = new AddressFormat(LIMITS).parse("#robots=128&flawed=many&seed=3.7&filter=best");
  const { robots, flawed, seed, filter } = settings;
  assert.deepEqual([robots, flawed, seed, filter], [20, 50, 3, "asdf-minus"]);
});

test("a filter that is called like a property of every object is none of the filters", () => {
  const { filter } = new AddressFormat(LIMITS).parse("#filter=constructor");
  assert.equal(filter, "asdf-minus");
});

test("a tenth of the robots more misjudge their sensors at a time, until all do", () => {
  const shares = [50, 95, 100].map((flawed) => miscalibrateMore({ ...SETTINGS, flawed }).flawed);
  assert.deepEqual(shares, [60, 100, 100]);
});

test("a liar more comes at a time, up to ten and to all robots but one", () => {
  assert.deepEqual([addLiar(SETTINGS).liars, addLiar({ ...SETTINGS, liars: 10 }).liars], [1, 10]);
  assert.equal(addLiar({ ...SETTINGS, robots: 3, liars: 2 }).liars, 2);
});

test("the description has the first robots as flawed, the last ones as liars, and the filter's two names", () => {
  const job = makeJob({ ...SETTINGS, filter: "asdf-minus", robots: 9, flawed: 20, liars: 2 });
  const { flawed, liars, filter, filter_term: term } = describeRun(job, { sides: null, floor: null });
  assert.deepEqual(
    [flawed, liars],
    [
      [0, 1],
      [8, 7],
    ],
  );
  assert.deepEqual([filter, term], ["asdf-minus", "ASDF−"]);
});

test("one robot at least is no liar", () => {
  assert.equal(limitLiars({ robots: 3, liars: 10 }).liars, 2);
});

test("the number of flawed robots is rounded half up", () => {
  const counts = [0, 30, 50, 52, 53].map((flawed) => makeJob({ ...SETTINGS, robots: 9, flawed }).flawedCount);
  assert.deepEqual(counts, [0, 3, 5, 5, 5]);
});

test("a run with many messages has fewer steps, and at most 1000 samples", () => {
  const jobs = [4, 40, 400].map((density) => makeJob({ ...SETTINGS, density }));
  assert.deepEqual(
    jobs.map(({ steps, interval }) => [steps, interval]),
    [
      [10000, 10],
      [5000, 5],
      [2000, 2],
    ],
  );
  assert.equal(makeJob({ ...SETTINGS, steps: 60 }).interval, 1);
});

test("the command has every setting of the run", () => {
  assert.equal(
    formatCommand(SETTINGS),
    "mcp-asdf simulate --seed 7 --robots 20 --topology dynamic --density 4 --filter robust --flawed 6 " +
      "--fill-ratio 0.55 --steps 10000 --flawed-accuracy 0.55 --true-accuracy 0.95",
  );
});

test("liars are the last robots, in a command of the bus", () => {
  const command = formatCommand({ ...SETTINGS, liars: 2, everybody: 1, steps: 100 });
  assert.match(command, /^mcp-asdf swarm .*--topology fully-connected/);
  assert.match(command, / --fault liar,robots=18-19,x=0,alpha=1e6$/);
});
