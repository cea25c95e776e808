// The history of a run: its description, and the states of all robots in typed arrays that grow.

export const ONE = 65534; // the 16-bit number that stands for the value 1
const UNKNOWN = 65535;
const SMALLEST_B_HAT_CHANGE = 0.002; // rounding alone changes b_hat by less

/** Returns the bytes that a base64 text encodes. */
export function decodeBase64(text) {
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}

/** Returns the inflated bytes of a base64 text, as an ArrayBuffer. */
async function inflateBase64(text) {
  const compressed = new Blob([decodeBase64(text)]).stream();
  const inflated = compressed.pipeThrough(new DecompressionStream("deflate"));
  return new Response(inflated).arrayBuffer();
}

/** Returns a typed array that begins with the values of `array` and has room for at least `length`. */
function reserve(array, length) {
  if (array.length >= length) return array;
  // To double the room at least keeps the cost of many small appends linear.
  const larger = new array.constructor(Math.max(length, 2 * array.length));
  larger.set(array);
  return larger;
}

/** Returns arrays of receiver, sender, receiver, sender and so on, one for each of `count` states. */
function readLinks(buffer, offset, count) {
  // The offset may be no multiple of 4, so these 32-bit numbers are only readable from a copy.
  const linkCounts = new Uint32Array(buffer.slice(offset, offset + 4 * count));
  const links = new Uint16Array(buffer, offset + 4 * count);
  // Differences to the link before become receivers and senders.
  for (let index = 2; index < links.length; index++) links[index] += links[index - 2];
  let start = 0;
  return Array.from(linkCounts, (linkCount) => {
    const end = start + 2 * linkCount;
    const linksOfState = links.subarray(start, end);
    start = end;
    return linksOfState;
  });
}

/** The states of a run so far. Methods name robots and states by their index. */
export class History {
  /** Creates a history without states; `description` is as view/history.py has it, with an inflated floor. */
  constructor(description) {
    this.description = description;
    this.robotCount = description.robots.length;
    this.robotsMove = description.sides !== null;
    this.stateCount = 0;
    this.ticks = new Uint32Array(0);
    this.columns = {};
    const positionColumns = this.robotsMove ? ["position_x", "position_y"] : [];
    for (const name of [...description.quantities, ...positionColumns]) {
      this.columns[name] = new Uint16Array(0);
    }
    this.linksByState = [];
    this.events = [];
    this.robotsOnceLost = new Set();
  }

  /** Returns a history without states, for a description as view/page.py encodes it. */
  static async decode(description) {
    const { floor } = description;
    if (floor === null) return new History(description);
    const bits = new Uint8Array(await inflateBase64(floor.bits));
    return new History({ ...description, floor: { ...floor, bits } });
  }

  /** Appends a block of states, laid out as `encode_states` of view/page.py describes. */
  async appendBlock({ count, data }) {
    const buffer = await inflateBase64(data);
    const ticks = new Uint32Array(buffer, 0, count);
    const columns = {};
    let offset = 4 * count;
    for (const name of Object.keys(this.columns)) {
      const differences = new Uint16Array(buffer, offset, count * this.robotCount);
      columns[name] = this.#sumDifferences(differences, count);
      offset += 2 * count * this.robotCount;
    }
    this.appendStates({ ticks, columns, links: readLinks(buffer, offset, count) });
  }

  /**
   * Appends states, and the events in them.
   *
   * A column has 16-bit numbers, all robots of a state beside each other. Links have an array for each state, of
   * receiver, sender, receiver, sender and so on.
   */
  appendStates({ ticks, columns, links }) {
    const oldCount = this.stateCount;
    const newCount = oldCount + ticks.length;
    this.ticks = reserve(this.ticks, newCount);
    this.ticks.set(ticks, oldCount);
    for (const [name, numbers] of Object.entries(columns)) {
      this.columns[name] = reserve(this.columns[name], newCount * this.robotCount);
      this.columns[name].set(numbers, oldCount * this.robotCount);
    }
    this.linksByState.push(...links);
    this.stateCount = newCount;
    for (let state = Math.max(oldCount, 1); state < newCount; state++) {
      this.#addFaultEvents(state);
      this.#addRobotEvents(state);
    }
  }

  /** Turns differences along each robot's series into a column, which has the robots of a state together. */
  #sumDifferences(differences, count) {
    const column = new Uint16Array(count * this.robotCount);
    for (let robot = 0; robot < this.robotCount; robot++) {
      let value = 0;
      for (let state = 0; state < count; state++) {
        value = (value + differences[robot * count + state]) & 0xffff;
        column[state * this.robotCount + robot] = value;
      }
    }
    return column;
  }

  /** Returns a quantity, such as "b_hat", of a robot in a state; NaN if unknown. */
  value(quantity, robot, state) {
    const number = this.columns[quantity][state * this.robotCount + robot];
    return number === UNKNOWN ? Number.NaN : number / ONE;
  }

  /** Returns x and y of a robot's centre in a state, in metres from the middle of the arena. */
  position(robot, state) {
    const index = state * this.robotCount + robot;
    const [width, height] = this.description.sides;
    const { position_x, position_y } = this.columns;
    return [(position_x[index] / ONE - 0.5) * width, (position_y[index] / ONE - 0.5) * height];
  }

  /** Returns [sender, receiver] of all links in a state, or of those of one receiver. */
  links(state, onlyReceiver = null) {
    const links = [];
    const indices = this.linksByState[state];
    for (let index = 0; index < indices.length; index += 2) {
      const receiver = indices[index];
      const sender = indices[index + 1];
      if (onlyReceiver === null || receiver === onlyReceiver) links.push([sender, receiver]);
    }
    return links;
  }

  /** The tick of the last state; 0 if there is none. */
  get lastTick() {
    return this.stateCount === 0 ? 0 : this.ticks[this.stateCount - 1];
  }

  /** Returns the last state that is not later than a tick, or 0 if all are later. O(log states). */
  stateAt(tick) {
    let low = 0;
    let high = this.stateCount;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.ticks[middle] <= tick) low = middle;
      else high = middle;
    }
    return low;
  }

  /** Returns how wrong a robot is about its sensor in a state, |b_hat - b|; NaN if unknown. */
  bHatError(robot, state) {
    return Math.abs(this.value("b_hat", robot, state) - this.value("b", robot, state));
  }

  /** Adds an event for each fault that began or ended since the state before. */
  #addFaultEvents(state) {
    const tick = this.ticks[state];
    const previousTick = this.ticks[state - 1];
    const isNew = (faultTick) =>
      faultTick !== null &&
      faultTick <= tick &&
      // Faults from tick 0 on are events of the second state, as the first has none before it.
      (faultTick > previousTick || (faultTick === 0 && state === 1));
    for (const [text, start, stop] of this.description.faults ?? []) {
      if (isNew(start)) this.events.push({ tick, state, text: `fault: ${text}` });
      if (isNew(stop)) this.events.push({ tick, state, text: `fault over: ${text}` });
    }
  }

  /** Adds an event for each robot that was lost, came back or changed its b_hat since the state before. */
  #addRobotEvents(state) {
    const tick = this.ticks[state];
    const lostText = this.description.steps === null ? "silent" : "dead"; // on a bus nobody knows which
    for (let robot = 0; robot < this.robotCount; robot++) {
      const before = this.value("b_hat", robot, state - 1);
      const after = this.value("b_hat", robot, state);
      const wasLost = Number.isNaN(before);
      const isLost = Number.isNaN(after);
      if (isLost && !wasLost) {
        this.events.push({ tick, state, robot, text: lostText });
        this.robotsOnceLost.add(robot);
      } else if (wasLost && !isLost && this.robotsOnceLost.has(robot)) {
        this.events.push({ tick, state, robot, text: "back" });
      } else if (Math.abs(after - before) > SMALLEST_B_HAT_CHANGE) {
        this.events.push({ tick, state, robot, before, after });
      }
    }
  }
}
