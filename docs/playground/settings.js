// The settings of a run: as an address, as a job of the worker, as a command, and as a history's description.

export const MAX_SAMPLES = 1000;
const TRIALS = 30; // of each filter
const STEPS_PER_SECOND = 10;
const MAX_LIARS = 10;
const RADIO_RANGE = 0.7; // metres
const INTEGER_SETTINGS = ["robots", "liars", "seed", "everybody", "steps"];

/** The filters by the names that programs use, each with a short name and in words. */
export const FILTERS = {
  none: { term: "no filter", words: "no filter" },
  "asdf-minus": { term: "ASDF−", words: "paper's filter in the flawed robots only (ASDF−)" },
  "asdf-plus": { term: "ASDF+", words: "paper's filter in all robots (ASDF+)" },
  robust: { term: "robust", words: "robust filter" },
};

/** Returns the settings with more robots that misjudge their sensors. */
export function miscalibrateMore(settings) {
  return { ...settings, flawed: Math.min(settings.flawed + 10, 100) };
}

/** Returns the settings with a liar more, if there may be one. */
export function addLiar(settings) {
  return limitLiars({ ...settings, liars: Math.min(settings.liars + 1, MAX_LIARS) });
}

/** Returns the settings with fewer liars, if there are not fewer liars than robots. */
export function limitLiars(settings) {
  return { ...settings, liars: Math.min(settings.liars, settings.robots - 1) };
}

/** Reads and writes settings as addresses, such as #flawed=50&filter=robust. */
export class AddressFormat {
  /** Takes name, minimum, maximum and defaultValue of each setting but the filter. */
  constructor(limits) {
    this.limits = limits;
    const defaults = limits.map(({ name, defaultValue }) => [name, defaultValue]);
    this.defaults = { ...Object.fromEntries(defaults), filter: "asdf-minus" };
  }

  /** Returns the settings of an address; bad and missing ones have their defaults. */
  parse(address) {
    const settings = { ...this.defaults };
    const parameters = new URLSearchParams(address.replace(/^#/, ""));
    for (const { name, minimum, maximum } of this.limits) {
      const value = Number(parameters.get(name) ?? Number.NaN);
      if (value >= minimum && value <= maximum) settings[name] = value;
    }
    for (const name of INTEGER_SETTINGS) settings[name] = Math.floor(settings[name]);
    const filter = parameters.get("filter");
    // Not `in`, which finds names that every object has, such as "constructor".
    if (Object.hasOwn(FILTERS, filter)) settings.filter = filter;
    return limitLiars(settings);
  }

  /** Returns the address of settings, which has those that are not defaults. */
  format(settings) {
    const names = Object.keys(this.defaults).filter((name) => settings[name] !== this.defaults[name]);
    return `#${names.map((name) => `${name}=${settings[name]}`).join("&")}`;
  }
}

/** Returns how many steps a run has by default: fewer if its robots receive so much that it would take long. */
function chooseSteps({ robots, density, everybody }) {
  const neighbours = everybody ? robots - 1 : density;
  const messagesPerStep = robots * neighbours;
  if (messagesPerStep <= 400) return 10000;
  if (messagesPerStep <= 1600) return 5000;
  return 2000;
}

/** Returns settings as the worker takes them, with the number of flawed robots, the steps and their interval. */
export function makeJob(settings) {
  const steps = settings.steps || chooseSteps(settings);
  return {
    ...settings,
    flawedCount: Math.floor((settings.flawed / 100) * settings.robots + 0.5),
    steps,
    interval: Math.max(steps / MAX_SAMPLES, 1),
    trials: TRIALS,
  };
}

/** Returns the command that computes the same bits: of all trials, or of the first one if there are liars. */
export function formatCommand(settings) {
  const job = makeJob(settings);
  const options = [
    `--seed ${job.seed} --robots ${job.robots}`,
    job.everybody ? "--topology fully-connected" : `--topology dynamic --density ${job.density}`,
    `--filter ${job.filter} --flawed ${job.flawedCount} --fill-ratio ${job.fill} --steps ${job.steps}`,
    `--flawed-accuracy ${job.wrong} --true-accuracy ${job.accuracy}`,
  ].join(" ");
  if (job.liars === 0) return `mcp-asdf simulate ${options}`;
  // Liars are a fault of a bus, which only `swarm` has.
  const liarIds = `${job.robots - job.liars}-${job.robots - 1}`;
  return `mcp-asdf swarm ${options} --fault liar,robots=${liarIds},x=0,alpha=1e6`;
}

/** Returns the description of a job's run, as `RunDescription` of view/history.py has it. */
export function describeRun(job, { sides, floor }) {
  const { term } = FILTERS[job.filter];
  return {
    title: `${job.robots} robots, ${job.flawedCount} flawed, ${term}`,
    robots: Array.from({ length: job.robots }, (_, robot) => robot),
    flawed: Array.from({ length: job.flawedCount }, (_, robot) => robot),
    liars: Array.from({ length: job.liars }, (_, liar) => job.robots - 1 - liar),
    filter: job.filter,
    filter_term: term,
    unfiltered_errors: [],
    quantities: ["x", "x_hat", "b_hat", "b"],
    fill_ratio: job.fill,
    steps: job.steps,
    steps_per_second: STEPS_PER_SECOND,
    radio_range: RADIO_RANGE,
    sides,
    floor,
  };
}
