// The arena: floor, robots, their radio range, and who hears whom.

import { colour, colourOfError } from "view/colours";

const BODY_RADIUS = 0.0704;
const TURN = 2 * Math.PI;
const MANY_ROBOTS = 128;
const MANY_LINKS = 240;
const MOST_LINKS = 4000; // more would be one grey disc

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
    this.liars = new Set(film.stage.liars);
  }

  /** Paints the floor again, in new colours. */
  recolour() {
    this.floor = null;
    this.isBlank = true;
  }

  #resize() {
    const ratio = window.devicePixelRatio || 1;
    const { width, height } = this.canvas.getBoundingClientRect();
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    this.ratio = ratio;
    this.isBlank = true;
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

  /** Draws the state at a tick; `chosen` is the robot followed, or null. */
  draw(tick, chosen) {
    const { context, film } = this;
    this.isBlank = false;
    if (this.canvas.width === 1) return; // hidden
    this.#fit();
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.#drawFloor();
    const sample = this.#place(tick);
    this.radius = film.moves
      ? Math.max(BODY_RADIUS * this.scale, (film.robots > MANY_ROBOTS ? 2.5 : 6) * this.ratio)
      : Math.min((this.scale * Math.PI) / film.robots / 1.6, 15 * this.ratio);
    if (film.moves) this.#drawRanges(sample, chosen);
    this.#drawLinks(film.heard(sample), chosen);
    for (let robot = film.robots - 1; robot >= 0; robot--) this.#drawRobot(robot, sample, chosen);
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
    const [width, height] = this.size;
    context.save();
    context.beginPath();
    context.rect(this.middle[0] - width / 2, this.middle[1] - height / 2, width, height);
    context.clip();
    context.lineWidth = this.ratio;
    this.places.forEach(([x, y], robot) => {
      context.beginPath();
      context.arc(x, y, film.stage.radio_range * this.scale, 0, TURN);
      context.strokeStyle = context.fillStyle = colourOfError(film.wrongness(robot, sample));
      context.globalAlpha = robot === chosen ? 0.16 : 0.035;
      context.fill();
      context.globalAlpha = robot === chosen ? 0.9 : 0.22;
      context.stroke();
    });
    context.restore();
  }

  #drawLinks(links, chosen) {
    const { context } = this;
    const isOfChosen = (pair) => pair.includes(chosen);
    this.#drawLines(
      links.length > MOST_LINKS ? [] : links.filter((pair) => !isOfChosen(pair)),
      colour("link"),
      links.length > MANY_LINKS ? 0.16 : 0.75,
    );
    this.#drawLines(links.filter(isOfChosen), colour("focus"), 1);
    context.globalAlpha = 1;
  }

  #drawLines(pairs, style, alpha) {
    const { context } = this;
    context.lineWidth = 1.4 * this.ratio;
    context.strokeStyle = style;
    context.globalAlpha = alpha;
    context.beginPath();
    for (const [sender, receiver] of pairs) {
      context.moveTo(...this.places[sender]);
      context.lineTo(...this.places[receiver]);
    }
    context.stroke();
  }

  #drawRobot(robot, sample, chosen) {
    const { context, radius } = this;
    const [x, y] = this.places[robot];
    const isGone = this.film.gone.has(robot) && Number.isNaN(this.film.value("b_hat", robot, sample));
    context.globalAlpha = isGone ? 0.4 : 1;
    context.beginPath();
    context.arc(x, y, radius, 0, TURN);
    context.fillStyle = this.liars.has(robot)
      ? colour("liar")
      : colourOfError(this.film.wrongness(robot, sample));
    context.fill();
    context.lineWidth = Math.min((this.flawed.has(robot) ? 2.6 : 1) * this.ratio, radius / 2);
    context.strokeStyle = colour(this.flawed.has(robot) ? "ink" : "card");
    context.stroke();
    if (robot === chosen) {
      context.beginPath();
      context.arc(x, y, radius + 4 * this.ratio, 0, TURN);
      context.strokeStyle = colour("focus");
      context.lineWidth = 2.5 * this.ratio;
      context.stroke();
    }
    this.#drawId(String(this.film.stage.robots[robot]), x, y);
    context.globalAlpha = 1;
  }

  /** An id, where it fits into its disc at a size that one can read. */
  #drawId(id, x, y) {
    const { context, radius, ratio } = this;
    const size = Math.min(Math.max(9 * ratio, 0.95 * radius), (1.6 * radius) / (0.6 * id.length));
    if (size < 7 * ratio) return;
    context.fillStyle = colour("card");
    context.font = `600 ${size}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(id, x, y + 0.5 * ratio);
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
  context.fillStyle = colour("white-tile");
  context.fillRect(0, 0, columns, rows);
  context.fillStyle = colour("black-tile");
  const stride = Math.ceil(columns / 8);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const isBlack = (bits[row * stride + (column >> 3)] >> (7 - (column & 7))) & 1;
      if (isBlack) context.fillRect(column, row, 1, 1);
    }
  }
  return canvas;
}
