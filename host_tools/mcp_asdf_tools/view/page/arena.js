// The arena: floor, robots, their radio range, who hears whom, and messages as they pass.

import { colour, colourOfError } from "view/colours";

const BODY_RADIUS = 0.0704;
const TURN = 2 * Math.PI;
const SLOW = 3;
const FLIGHTS_PER_SECOND = 1.2;
const MOST_FLIGHTS = 240;
const TRAIL_SAMPLES = 120;

export class Arena {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.places = [];
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
  }

  show(film) {
    this.film = film;
    this.floor = null;
    this.flawed = new Set(film.stage.flawed);
  }

  /** The floor is painted anew, in the colours of the present theme. */
  repaint() {
    this.floor = null;
  }

  #resize() {
    const ratio = window.devicePixelRatio || 1;
    const { width, height } = this.canvas.getBoundingClientRect();
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    this.ratio = ratio;
  }

  /** Maps metres to pixels; robots that do not move stand on a circle of radius 1. */
  #fit() {
    const [width, height] = this.film.stage.sides ?? [2.5, 2.5];
    const margin = 3 * this.ratio;
    const across = (this.canvas.width - 2 * margin) / width;
    const down = (this.canvas.height - 2 * margin) / height;
    this.scale = Math.min(across, down);
    this.middle = [this.canvas.width / 2, this.canvas.height / 2];
    this.size = [width * this.scale, height * this.scale];
  }

  #toPixels([x, y]) {
    return [this.middle[0] + x * this.scale, this.middle[1] - y * this.scale];
  }

  /** Where the robots are at a tick, between two samples on the line from one to the other. */
  #place(tick) {
    const { film } = this;
    const sample = film.sampleAt(tick);
    const next = Math.min(sample + 1, film.length - 1);
    const span = film.ticks[next] - film.ticks[sample];
    const share = span > 0 ? Math.min((tick - film.ticks[sample]) / span, 1) : 0;
    this.places = film.stage.robots.map((_, robot) => {
      if (!film.moves) {
        const angle = (TURN * robot) / film.robots - TURN / 4;
        return this.#toPixels([Math.cos(angle), -Math.sin(angle)]);
      }
      const [x, y] = film.position(robot, sample);
      const [nextX, nextY] = film.position(robot, next);
      return this.#toPixels([x + share * (nextX - x), y + share * (nextY - y)]);
    });
    return sample;
  }

  /** Draws the state at a tick. `flow` counts messages' flights, `chosen` is the robot followed, or null. */
  draw(tick, { flow, stepsPerSecond, chosen, recent }) {
    const { context, film } = this;
    this.#fit();
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.#drawFloor();
    if (film.length === 0) return;
    const sample = this.#place(tick);
    this.radius = film.moves
      ? Math.max(BODY_RADIUS * this.scale, 6 * this.ratio)
      : Math.min((this.scale * Math.PI) / film.robots / 1.6, 15 * this.ratio);
    const links = this.#links(sample);
    this.#drawRanges(sample, chosen);
    if (chosen !== null && film.moves) this.#drawTrail(sample, chosen);
    this.#drawLinks(links, chosen);
    this.#drawMessages(links, sample, this.#phase(tick, flow, stepsPerSecond), chosen);
    for (const { robot, age } of recent) this.#drawUpdate(robot, age, sample);
    for (let robot = film.robots - 1; robot >= 0; robot--) this.#drawRobot(robot, sample, chosen);
  }

  /** Slow films show each broadcast, and fast ones so many that the eye can follow. */
  #phase(tick, flow, stepsPerSecond) {
    const period = this.film.stage.commsPeriod;
    return stepsPerSecond / period <= SLOW ? tick / period : flow * FLIGHTS_PER_SECOND;
  }

  #links(sample) {
    const pairs = [];
    const { film } = this;
    for (let receiver = 0; receiver < film.robots; receiver++) {
      for (let sender = 0; sender < film.robots; sender++) {
        if (film.hears(receiver, sender, sample)) pairs.push([sender, receiver]);
      }
    }
    return pairs;
  }

  #drawFloor() {
    const { context, film } = this;
    const [width, height] = this.size;
    const [left, top] = [this.middle[0] - width / 2, this.middle[1] - height / 2];
    const { floor } = film.stage;
    if (floor) {
      this.floor ??= paintedFloor(floor);
      context.imageSmoothingEnabled = floor.columns > width / 3;
      context.drawImage(this.floor, left, top, width, height);
    }
    if (film.moves) {
      context.strokeStyle = colour("soft");
      context.lineWidth = 1.5 * this.ratio;
      context.strokeRect(left, top, width, height);
    }
  }

  #drawRanges(sample, chosen) {
    const { context, film } = this;
    if (!film.moves) return;
    const [width, height] = this.size;
    context.save();
    context.beginPath();
    context.rect(this.middle[0] - width / 2, this.middle[1] - height / 2, width, height);
    context.clip();
    context.lineWidth = this.ratio;
    this.places.forEach(([x, y], robot) => {
      context.beginPath();
      context.arc(x, y, film.stage.radioRange * this.scale, 0, TURN);
      context.strokeStyle = context.fillStyle = colourOfError(film.wrongness(robot, sample));
      context.globalAlpha = robot === chosen ? 0.16 : 0.035;
      context.fill();
      context.globalAlpha = robot === chosen ? 0.9 : 0.22;
      context.stroke();
    });
    context.restore();
  }

  #drawTrail(sample, chosen) {
    const { context, film } = this;
    context.beginPath();
    for (let i = Math.max(0, sample - TRAIL_SAMPLES); i <= sample; i++) {
      context.lineTo(...this.#toPixels(film.position(chosen, i)));
    }
    context.lineTo(...this.places[chosen]);
    context.strokeStyle = colour("focus");
    context.lineWidth = 2 * this.ratio;
    context.stroke();
  }

  #drawLinks(links, chosen) {
    const { context } = this;
    context.lineWidth = 1.4 * this.ratio;
    context.strokeStyle = colour("link");
    context.globalAlpha = links.length > MOST_FLIGHTS ? 0.16 : 0.75;
    context.beginPath();
    for (const [sender, receiver] of links) {
      if (sender === chosen || receiver === chosen) continue;
      context.moveTo(...this.places[sender]);
      context.lineTo(...this.places[receiver]);
    }
    context.stroke();
    context.globalAlpha = 1;
    context.strokeStyle = colour("focus");
    context.beginPath();
    for (const [sender, receiver] of links) {
      if (sender !== chosen && receiver !== chosen) continue;
      context.moveTo(...this.places[sender]);
      context.lineTo(...this.places[receiver]);
    }
    context.stroke();
  }

  /** A dot on its way from sender to receiver, coloured as the sender; all of a robot leave together. */
  #drawMessages(links, sample, phase, chosen) {
    const { context, film } = this;
    const isCrowded = links.length > MOST_FLIGHTS;
    for (const [sender, receiver] of links) {
      if (isCrowded && receiver !== (chosen ?? 0)) continue;
      const share = (phase + 0.37 * sender) % 1;
      const [from, to] = [this.places[sender], this.places[receiver]];
      context.beginPath();
      const [x, y] = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
      context.arc(x, y, 3 * this.ratio, 0, TURN);
      context.fillStyle = colourOfError(film.wrongness(sender, sample));
      context.fill();
    }
  }

  /** A ring that grows from a robot that has just changed its mind about its sensor. */
  #drawUpdate(robot, age, sample) {
    const { context } = this;
    context.beginPath();
    context.arc(...this.places[robot], this.radius * (1.2 + 2.6 * age), 0, TURN);
    context.strokeStyle = colourOfError(this.film.wrongness(robot, sample));
    context.lineWidth = 3 * this.ratio * (1 - age);
    context.stroke();
  }

  #drawRobot(robot, sample, chosen) {
    const { context, radius } = this;
    const [x, y] = this.places[robot];
    context.beginPath();
    context.arc(x, y, radius, 0, TURN);
    context.fillStyle = colourOfError(this.film.wrongness(robot, sample));
    context.fill();
    context.lineWidth = (this.flawed.has(robot) ? 2.6 : 1) * this.ratio;
    context.strokeStyle = colour(this.flawed.has(robot) ? "ink" : "card");
    context.stroke();
    if (robot === chosen) {
      context.beginPath();
      context.arc(x, y, radius + 4 * this.ratio, 0, TURN);
      context.strokeStyle = colour("focus");
      context.lineWidth = 2.5 * this.ratio;
      context.stroke();
    }
    context.fillStyle = colour("card");
    context.font = `600 ${Math.max(9 * this.ratio, 0.95 * radius)}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(String(this.film.stage.robots[robot]), x, y + 0.5 * this.ratio);
  }

  /** The robot under a mouse event, or null. */
  robotAt({ offsetX, offsetY }) {
    const [x, y] = [offsetX * this.ratio, offsetY * this.ratio];
    const distances = this.places.map((place) => Math.hypot(place[0] - x, place[1] - y));
    const nearest = distances.indexOf(Math.min(...distances));
    return distances[nearest] < Math.max(1.6 * this.radius, 14 * this.ratio) ? nearest : null;
  }
}

/** The tiles as a picture, one pixel each. */
function paintedFloor({ rows, columns, bits }) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [columns, rows];
  const context = canvas.getContext("2d");
  const image = context.createImageData(columns, rows);
  const pixels = new Uint32Array(image.data.buffer);
  const [white, black] = ["white-tile", "black-tile"].map((name) => pixelOf(colour(name)));
  const stride = Math.ceil(columns / 8);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const isBlack = (bits[row * stride + (column >> 3)] >> (7 - (column & 7))) & 1;
      pixels[row * columns + column] = isBlack ? black : white;
    }
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

function pixelOf(hex) {
  const value = Number.parseInt(hex.slice(1), 16);
  return (0xff000000 | ((value & 0xff) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}
