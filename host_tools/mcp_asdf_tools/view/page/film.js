// The film of a run: what stays the same, and samples of every robot in typed arrays that grow.

const SCALE = 65534;
const UNKNOWN = 65535;
const MOST_WITH_BITS = 128; // robots with a bit for each two of them

/** Bytes of base64 text. */
export function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Bytes of deflated base64 text. */
async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** A typed array with room for more. */
function grown(array, length) {
  if (array.length >= length) return array;
  const larger = new array.constructor(Math.max(length, 2 * array.length));
  larger.set(array);
  return larger;
}

export class Film {
  constructor(stage) {
    this.stage = stage;
    this.robots = stage.robots.length;
    this.moves = stage.sides !== null;
    this.length = 0;
    this.ticks = new Uint32Array(0);
    this.columns = {};
    for (const name of [...stage.quantities, ...(this.moves ? ["px", "py"] : [])]) {
      this.columns[name] = new Uint16Array(0);
    }
    this.linkBytes = Math.ceil(this.robots ** 2 / 8);
    this.links = new Uint8Array(0);
    this.pairs = this.robots > MOST_WITH_BITS ? [] : null; // of receivers and senders, by sample
    this.events = [];
    this.gone = new Set();
  }

  /** An empty film on a stage as view/page.py writes it. */
  static async on(stage) {
    const { floor } = stage;
    if (floor === null) return new Film(stage);
    const bits = new Uint8Array(await inflated(floor.bits));
    return new Film({ ...stage, floor: { ...floor, bits } });
  }

  /** A whole film of samples at equal distances, from columns of 16-bit numbers and links as they are kept. */
  static of(stage, interval, columns, links) {
    const film = new Film(stage);
    film.length = links.length / film.linkBytes;
    film.ticks = Uint32Array.from({ length: film.length }, (_, sample) => sample * interval);
    Object.assign(film, { columns, links });
    for (let sample = 1; sample < film.length; sample++) film.#findEvents(sample);
    return film;
  }

  /** Takes a block of samples, laid out as view/page.py writes it. */
  async append({ count, data }) {
    const buffer = await inflated(data);
    const total = this.length + count;
    this.ticks = grown(this.ticks, total);
    this.ticks.set(new Uint32Array(buffer, 0, count), this.length);
    let offset = 4 * count;
    for (const name of Object.keys(this.columns)) {
      const differences = new Uint16Array(buffer, offset, count * this.robots);
      this.columns[name] = grown(this.columns[name], total * this.robots);
      this.#sum(differences, count, this.columns[name]);
      offset += 2 * count * this.robots;
    }
    if (this.pairs) this.#appendPairs(buffer, offset, count);
    else {
      this.links = grown(this.links, total * this.linkBytes);
      this.links.set(new Uint8Array(buffer, offset), this.length * this.linkBytes);
    }
    const first = Math.max(this.length, 1);
    this.length = total;
    for (let sample = first; sample < total; sample++) this.#findEvents(sample);
  }

  #appendPairs(buffer, offset, count) {
    // Copied, since places that are no multiple of 4 bytes cannot be read as such.
    const counts = new Uint32Array(buffer.slice(offset, offset + 4 * count));
    let start = offset + 4 * count;
    for (const pairs of counts) {
      this.pairs.push(new Uint16Array(buffer, start, 2 * pairs));
      start += 4 * pairs;
    }
  }

  /** Differences along each robot's series become values, the robots of a sample beside each other. */
  #sum(differences, count, column) {
    for (let robot = 0; robot < this.robots; robot++) {
      let value = 0;
      for (let i = 0; i < count; i++) {
        value = (value + differences[robot * count + i]) & 0xffff;
        column[(this.length + i) * this.robots + robot] = value;
      }
    }
  }

  /** A quantity of a robot in a sample; NaN if unknown. */
  value(name, robot, sample) {
    const raw = this.columns[name][sample * this.robots + robot];
    return raw === UNKNOWN ? Number.NaN : raw / SCALE;
  }

  /** Centre of a robot in metres from the middle of the arena. */
  position(robot, sample) {
    const at = sample * this.robots + robot;
    const [width, height] = this.stage.sides;
    const { px, py } = this.columns;
    return [(px[at] / SCALE - 0.5) * width, (py[at] / SCALE - 0.5) * height];
  }

  /** Who hears whom in a sample: [sender, receiver] of each, or of those that one receiver hears. */
  heard(sample, only = null) {
    const found = [];
    if (this.pairs) {
      const pairs = this.pairs[sample];
      for (let at = 0; at < pairs.length; at += 2) {
        if (only === null || pairs[at] === only) found.push([pairs[at + 1], pairs[at]]);
      }
      return found;
    }
    for (let receiver = only ?? 0; receiver <= (only ?? this.robots - 1); receiver++) {
      for (let sender = 0; sender < this.robots; sender++) {
        const bit = receiver * this.robots + sender;
        const byte = this.links[sample * this.linkBytes + (bit >> 3)];
        if ((byte >> (bit & 7)) & 1) found.push([sender, receiver]);
      }
    }
    return found;
  }

  get lastTick() {
    return this.length ? this.ticks[this.length - 1] : 0;
  }

  /** The last sample that is not later than a tick; 0 if all are. O(log samples). */
  sampleAt(tick) {
    let [low, high] = [0, this.length];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.ticks[middle] <= tick) low = middle;
      else high = middle;
    }
    return low;
  }

  /** How wrong a robot is about its sensor, |b_hat - b|; NaN if unknown. */
  wrongness(robot, sample) {
    return Math.abs(this.value("b_hat", robot, sample) - this.value("b", robot, sample));
  }

  /** Notes what happened since the sample before: faults, deaths, returns, and changes of b_hat above rounding. */
  #findEvents(sample) {
    const [first, tick] = [sample - 1, sample].map((each) => this.ticks[each]);
    const isDue = (at) => at !== null && at <= tick && (at > first || (at === 0 && sample === 1));
    const mark = (event) => this.events.push({ tick, sample, isMark: true, ...event });
    const gone = this.stage.steps === null ? "silent" : "dead"; // on a bus one cannot see which
    for (const [text, start, stop] of this.stage.faults ?? []) {
      if (isDue(start)) mark({ text: `fault: ${text}` });
      if (isDue(stop)) mark({ text: `fault over: ${text}` });
    }
    this.stage.robots.forEach((_, robot) => {
      const [before, after] = [sample - 1, sample].map((each) => this.value("b_hat", robot, each));
      const [wasGone, isGone] = [before, after].map(Number.isNaN);
      if (isGone && !wasGone) mark({ robot, text: gone });
      if (wasGone && !isGone && this.gone.has(robot)) mark({ robot, text: "back" });
      if (Math.abs(after - before) > 0.002) this.events.push({ tick, sample, robot, before, after });
      if (isGone && !wasGone) this.gone.add(robot);
    });
  }
}
