// The playground's worker: it runs firmware, engine and arena, as WebAssembly, for one job after the other. A new job
// ends the one before. The worker imports nothing, since import maps do not reach workers.

const FILTERS = ["none", "asdf-minus", "asdf-plus", "robust"]; // in the order of filter_t in playground.c
const ONE = 65534; // the 16-bit number that stands for the value 1 in a history
const WORDS_PER_RECORD = 10;
const RECORD_WORDS = { x_hat: 4, x: 7, b_hat: 8 }; // indices in mcp_asdf_record_t
const X_UNIT = 2 ** 23;
const B_HAT_UNIT = 2 ** 32;

let engine = null; // what playground.c exports
let nextJob = null;
let isWorking = false;

/** Writes a job into settings_t of playground.c. */
function writeSettings(job) {
  const view = new DataView(engine.memory.buffer, engine.settings.value);
  const density = job.everybody ? 0 : job.density;
  const doubles = [job.fill, job.accuracy, job.wrong, density];
  const words = [job.seed, job.robots, job.flawedCount, job.liars, job.steps, job.interval];
  doubles.forEach((value, index) => {
    view.setFloat64(8 * index, value, true);
  });
  words.forEach((value, index) => {
    view.setUint32(8 * doubles.length + 4 * index, value, true);
  });
}

/** Returns a copy of the first `length` values of an array that playground.c exports. */
function readArray(ArrayType, name, length) {
  return new ArrayType(engine.memory.buffer, engine[name].value, length).slice();
}

/** Returns how many samples a trial of a job has: one of its start, and one after every interval. */
function countSamples(job) {
  return job.steps / job.interval + 1;
}

/** Runs a trial; returns the robots' mean error in each sample. */
function runTrial(job, filter, trial, isRecorded = false) {
  const status = engine.run_trial(FILTERS.indexOf(filter), trial, isRecorded);
  if (status !== 0) throw new Error(`the firmware refuses these settings, status ${status}`);
  return readArray(Float64Array, "errors", countSamples(job));
}

/** Returns receiver, sender, receiver, sender and so on of all pairs of robots for which `isLinked` is true. */
function findLinks(robots, isLinked) {
  const links = [];
  for (let receiver = 0; receiver < robots; receiver++) {
    for (let sender = 0; sender < robots; sender++) {
      if (sender !== receiver && isLinked(receiver, sender)) links.push(receiver, sender);
    }
  }
  return Uint16Array.from(links);
}

/** Returns sides, floor, links and positions of trial 0; robots that do not move have links alone. */
function recordMotion(job) {
  const samples = countSamples(job);
  if (job.everybody) {
    const allLinks = findLinks(job.robots, () => true);
    return { sides: null, floor: null, links: new Array(samples).fill(allLinks), positions: {} };
  }
  const pixels = engine.record_motion();
  const side = engine.arena_side();
  const linkBytes = Math.ceil(job.robots ** 2 / 8);
  const linkBits = readArray(Uint8Array, "links", samples * linkBytes);
  const linksOfSample = (_, sample) =>
    findLinks(job.robots, (receiver, sender) => {
      const bit = receiver * job.robots + sender;
      return (linkBits[sample * linkBytes + (bit >> 3)] >> (bit & 7)) & 1;
    });
  const metres = readArray(Float64Array, "positions", 2 * samples * job.robots);
  const positionColumn = (axis) =>
    Uint16Array.from({ length: samples * job.robots }, (_, index) =>
      Math.round((metres[2 * index + axis] / side + 0.5) * ONE),
    );
  return {
    sides: [side, side],
    floor: { rows: pixels, columns: pixels, bits: readArray(Uint8Array, "pixels", pixels ** 2 / 8) },
    links: Array.from({ length: samples }, linksOfSample),
    positions: { position_x: positionColumn(0), position_y: positionColumn(1) },
  };
}

/** Returns the values of all robots as columns of a history: first their start, then the records. */
function estimateColumns(job, records) {
  const recordCount = records.length / WORDS_PER_RECORD;
  const column = (initialValues, word, unit) => {
    const recordedValues = Array.from(
      { length: recordCount },
      (_, record) => records[WORDS_PER_RECORD * record + word] / unit,
    );
    return Uint16Array.from([...initialValues, ...recordedValues], (value) => Math.round(value * ONE));
  };
  const robots = Array.from({ length: job.robots }, (_, robot) => robot);
  const initialEstimates = robots.map(() => 0.5);
  const initialBHats = robots.map((robot) => (robot < job.flawedCount ? job.wrong : job.accuracy));
  const valueCount = job.robots * countSamples(job);
  return {
    x: column(initialEstimates, RECORD_WORDS.x, X_UNIT),
    x_hat: column(initialEstimates, RECORD_WORDS.x_hat, X_UNIT),
    b_hat: column(initialBHats, RECORD_WORDS.b_hat, B_HAT_UNIT),
    b: new Uint16Array(valueCount).fill(Math.round(job.accuracy * ONE)),
  };
}

/** Yields the results of a job: first the run to show, by the chosen filter, then the errors of all trials. */
function* computeResults(job) {
  writeSettings(job);
  const { positions, ...motion } = recordMotion(job);
  const firstErrors = runTrial(job, job.filter, 0, true);
  const recordWords = (job.steps / job.interval) * job.robots * WORDS_PER_RECORD;
  const records = readArray(Uint32Array, "records", recordWords);
  const columns = { ...estimateColumns(job, records), ...positions };
  const ticks = Uint32Array.from({ length: countSamples(job) }, (_, sample) => sample * job.interval);
  yield { run: { ...motion, ticks, columns }, records, filter: job.filter, trial: 0, errors: firstErrors };
  // Those of which the page shows large figures come first.
  const isFirst = (filter) => filter === "none" || filter === job.filter;
  for (const filters of [FILTERS.filter(isFirst), FILTERS.filter((filter) => !isFirst(filter))]) {
    for (let trial = 0; trial < job.trials; trial++) {
      for (const filter of filters) {
        const isDone = trial === 0 && filter === job.filter;
        if (!isDone) yield { filter, trial, errors: runTrial(job, filter, trial) };
      }
    }
  }
}

/** Posts the results of the next job, and of those that come meanwhile, until there is none. */
async function work() {
  isWorking = true;
  while (nextJob !== null) {
    const job = nextJob;
    nextJob = null;
    try {
      for (const result of computeResults(job)) {
        postMessage({ ...result, id: job.id });
        await new Promise((resume) => setTimeout(resume)); // so that the message of a new job is received
        if (nextJob !== null) break;
      }
    } catch (error) {
      postMessage({ id: job.id, error: error.message });
    }
  }
  isWorking = false;
}

addEventListener("message", async ({ data }) => {
  if (data.module) engine = (await WebAssembly.instantiate(data.module)).instance.exports;
  else nextJob = data;
  if (engine !== null && nextJob !== null && !isWorking) work();
});
