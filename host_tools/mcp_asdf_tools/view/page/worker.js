// The playground's worker: firmware, engine and arena as WebAssembly, asked for one run after the other. A new
// question ends the answer to the one before. It imports nothing, since import maps do not reach workers.

const FILTERS = ["none", "asdf-minus", "asdf-plus", "robust"];
const TRIALS = 30;
const SCALE = 65534;
const RECORD = { words: 10, x_hat: 4, x: 7, b_hat: 8 }; // mcp_asdf_record_t, in 32-bit words

let engine = null;
let wanted = null;
let isBusy = false;

/** Writes settings_t of playground.c. */
function write(job) {
  const view = new DataView(engine.memory.buffer, engine.settings.value);
  const doubles = [job.fill, job.accuracy, job.wrong, job.everybody ? 0 : job.density];
  for (const [at, value] of doubles.entries()) view.setFloat64(8 * at, value, true);
  const words = [job.seed, job.robots, job.flawedCount, job.liars, job.steps, job.interval];
  for (const [at, value] of words.entries()) view.setUint32(32 + 4 * at, value, true);
}

/** A copy of `length` values at a place of the module's memory that it exports by name. */
function read(Kind, name, length) {
  return new Kind(engine.memory.buffer, engine[name].value, length).slice();
}

function run(job, filter, trial, isRecorded = false) {
  const status = engine.run(FILTERS.indexOf(filter), trial, isRecorded);
  if (status !== 0) throw new Error(`the firmware refuses these settings, status ${status}`);
  return read(Float64Array, "errors", job.steps / job.interval + 1);
}

/** Positions, links and floor of trial 0; robots that do not move all hear each other. */
function motion(job) {
  const samples = job.steps / job.interval + 1;
  const linkBytes = Math.ceil(job.robots ** 2 / 8);
  if (job.everybody)
    return { sides: null, floor: null, links: new Uint8Array(samples * linkBytes).fill(255) };
  const pixels = engine.film();
  const side = engine.side();
  const places = read(Float64Array, "positions", 2 * samples * job.robots);
  const columns = [0, 1].map((axis) =>
    Uint16Array.from({ length: samples * job.robots }, (_, at) =>
      Math.round((places[2 * at + axis] / side + 0.5) * SCALE),
    ),
  );
  return {
    sides: [side, side],
    floor: { rows: pixels, columns: pixels, bits: read(Uint8Array, "pixels", pixels ** 2 / 8) },
    links: read(Uint8Array, "links", samples * linkBytes),
    px: columns[0],
    py: columns[1],
  };
}

/** What each robot estimates in the recorded trial, with step 0 before it, in a film's units. */
function estimates(job, words) {
  const { robots } = job;
  const column = (first, at, unit) =>
    Uint16Array.from({ length: robots + words.length / RECORD.words }, (_, place) =>
      Math.round(
        (place < robots ? first(place) : words[RECORD.words * (place - robots) + at] / unit) * SCALE,
      ),
    );
  const start = (robot) => (robot < job.flawedCount ? job.wrong : job.accuracy);
  const half = () => 0.5;
  return {
    x: column(half, RECORD.x, 2 ** 23),
    x_hat: column(half, RECORD.x_hat, 2 ** 23),
    b_hat: column(start, RECORD.b_hat, 2 ** 32),
  };
}

/** The answer, part by part: first the film of the chosen filter, then the errors of all trials. */
function* answers(job) {
  write(job);
  const moved = motion(job);
  const first = run(job, job.filter, 0, true);
  const words = read(Uint32Array, "records", (job.steps / job.interval) * job.robots * RECORD.words);
  yield {
    film: { ...moved, columns: estimates(job, words) },
    filter: job.filter,
    trial: 0,
    errors: first,
    words,
  };
  for (let trial = 0; trial < TRIALS; trial++) {
    for (const filter of FILTERS) {
      if (trial > 0 || filter !== job.filter) yield { filter, trial, errors: run(job, filter, trial) };
    }
  }
}

async function work() {
  isBusy = true;
  while (wanted) {
    const job = wanted;
    wanted = null;
    try {
      for (const part of answers(job)) {
        postMessage({ ...part, id: job.id });
        await new Promise((resume) => setTimeout(resume)); // lets the next question in
        if (wanted) break;
      }
    } catch (error) {
      postMessage({ id: job.id, error: error.message });
    }
  }
  isBusy = false;
}

addEventListener("message", async ({ data }) => {
  if (data.module) engine = (await WebAssembly.instantiate(data.module)).instance.exports;
  else wanted = data;
  if (engine && wanted && !isBusy) work();
});
