// The arena: the floor, the robots with their radio ranges, and the links between them.

import { colour, colourOfError } from "view/colours";
import { findElement } from "view/panels";

const BODY_RADIUS = 0.0704; // metres
const FULL_TURN = 2 * Math.PI;
const CIRCLE_SIDES = [2.5, 2.5]; // around the circle of radius 1 on which robots stand that do not move
const MANY_ROBOTS = 128;
const MANY_LINKS = 240;
const MAX_LINKS = 4000; // more would be one grey disc

/** Draws states of a history on a canvas, in pixels of the screen. */
export class Arena {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.centres = []; // of the robots, as last drawn
    this.specialColours = new Map(); // by robot, in place of that of its error
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
  }

  /** Takes the history that is to be drawn from now on. */
  show(history) {
    this.history = history;
    this.floorImage = null;
    findElement("tiles").parentElement.hidden = !history.description.floor;
    this.flawedRobots = new Set(history.description.flawed);
  }

  /** Makes the next `draw` paint the floor again, in new colours. */
  recolour() {
    this.floorImage = null;
    this.isBlank = true;
  }

  #resize() {
    const { width, height } = this.canvas.getBoundingClientRect();
    this.pixelRatio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(width * this.pixelRatio));
    this.canvas.height = Math.max(1, Math.round(height * this.pixelRatio));
    this.isBlank = true; // a canvas that changes its size loses its content
  }

  /** Draws the state at a tick; the robot `followedRobot` stands out, unless it is null. */
  draw(tick, followedRobot) {
    const { context, canvas, history } = this;
    this.isBlank = false;
    const isHidden = canvas.width === 1;
    if (isHidden) return;
    this.#fitToCanvas();
    context.clearRect(0, 0, canvas.width, canvas.height);
    this.#drawFloor();
    const state = history.stateAt(tick);
    this.centres = this.#centresAt(tick, state);
    this.radius = this.#radiusOfRobots();
    if (history.robotsMove) this.#drawRanges(state, followedRobot);
    this.#drawLinks(history.links(state), followedRobot);
    // The first robots, among which the flawed ones are, are drawn last and so above the others.
    for (let robot = history.robotCount - 1; robot >= 0; robot--) {
      this.#drawRobot(robot, state, followedRobot);
    }
  }

  /** Sets scale (pixels per metre), middle and size so that the arena fills the canvas but for a margin. */
  #fitToCanvas() {
    const [width, height] = this.history.description.sides ?? CIRCLE_SIDES;
    const margin = 3 * this.pixelRatio;
    const horizontalScale = (this.canvas.width - 2 * margin) / width;
    const verticalScale = (this.canvas.height - 2 * margin) / height;
    this.scale = Math.min(horizontalScale, verticalScale);
    this.middle = [this.canvas.width / 2, this.canvas.height / 2];
    this.size = [width * this.scale, height * this.scale];
  }

  /** Returns the pixel of a point in metres from the middle, whose y axis points up. */
  #toPixel([x, y]) {
    return [this.middle[0] + x * this.scale, this.middle[1] - y * this.scale];
  }

  /** Returns the pixels of all robots' centres; between two states they move on a straight line. */
  #centresAt(tick, state) {
    const { history } = this;
    if (!history.robotsMove) {
      return history.description.robots.map((_, robot) => this.#centreOnCircle(robot));
    }
    const nextState = Math.min(state + 1, history.stateCount - 1);
    const ticksBetween = history.ticks[nextState] - history.ticks[state];
    const share = ticksBetween > 0 ? Math.min((tick - history.ticks[state]) / ticksBetween, 1) : 0;
    return history.description.robots.map((_, robot) => {
      const [x, y] = history.position(robot, state);
      const [nextX, nextY] = history.position(robot, nextState);
      return this.#toPixel([x + share * (nextX - x), y + share * (nextY - y)]);
    });
  }

  /** Returns the pixel of a robot that does not move: clockwise on a circle, the first at the top. */
  #centreOnCircle(robot) {
    const angle = (FULL_TURN * robot) / this.history.robotCount - FULL_TURN / 4;
    return this.#toPixel([Math.cos(angle), -Math.sin(angle)]);
  }

  #radiusOfRobots() {
    const { robotCount, robotsMove } = this.history;
    if (robotsMove) {
      const smallestRadius = robotCount > MANY_ROBOTS ? 2.5 : 8; // in which two digits fit
      return Math.max(BODY_RADIUS * this.scale, smallestRadius * this.pixelRatio);
    }
    const radiusBetweenNeighbours = (this.scale * Math.PI) / robotCount / 1.6;
    return Math.min(radiusBetweenNeighbours, 15 * this.pixelRatio);
  }

  /** Returns left, top, width and height of the arena in pixels. */
  #bounds() {
    const [width, height] = this.size;
    return [this.middle[0] - width / 2, this.middle[1] - height / 2, width, height];
  }

  #drawFloor() {
    const { context, history } = this;
    const [left, top, width, height] = this.#bounds();
    const { floor } = history.description;
    if (floor) {
      if (this.floorImage === null) {
        this.floorImage = paintFloor(floor);
        showTiles(this.floorImage);
      }
      // Tiles that are smaller than pixels are averaged; larger ones keep their edges.
      context.imageSmoothingEnabled = floor.columns > width / 3;
      context.drawImage(this.floorImage, left, top, width, height);
    }
    if (history.robotsMove) {
      context.strokeStyle = colour("soft");
      context.lineWidth = 1.5 * this.pixelRatio;
      context.strokeRect(left, top, width, height);
    }
  }

  /** Draws a disc of the radio range around each robot, as far as it is inside the arena. */
  #drawRanges(state, followedRobot) {
    const { context, history } = this;
    const range = history.description.radio_range * this.scale;
    context.save();
    context.beginPath();
    context.rect(...this.#bounds());
    context.clip();
    context.lineWidth = this.pixelRatio;
    this.centres.forEach(([x, y], robot) => {
      const robotColour = colourOfError(history.bHatError(robot, state));
      context.beginPath();
      context.arc(x, y, range, 0, FULL_TURN);
      context.fillStyle = robotColour;
      context.globalAlpha = robot === followedRobot ? 0.16 : 0.035;
      context.fill();
      context.strokeStyle = robotColour;
      context.globalAlpha = robot === followedRobot ? 0.9 : 0.22;
      context.stroke();
    });
    context.restore();
  }

  /** Draws the links between robots; if there are too many, only those of the followed robot. */
  #drawLinks(links, followedRobot) {
    const isOfFollowedRobot = (link) => link.includes(followedRobot);
    if (links.length <= MAX_LINKS) {
      const otherLinks = links.filter((link) => !isOfFollowedRobot(link));
      this.#drawLines(otherLinks, colour("link"), links.length > MANY_LINKS ? 0.16 : 0.75);
    }
    this.#drawLines(links.filter(isOfFollowedRobot), colour("focus"), 1);
    this.context.globalAlpha = 1;
  }

  #drawLines(links, strokeStyle, alpha) {
    const { context } = this;
    context.lineWidth = 1.4 * this.pixelRatio;
    context.strokeStyle = strokeStyle;
    context.globalAlpha = alpha;
    context.beginPath();
    for (const [sender, receiver] of links) {
      context.moveTo(...this.centres[sender]);
      context.lineTo(...this.centres[receiver]);
    }
    context.stroke();
  }

  /** Draws a robot's body, a dark edge if it was flawed at the start, its id, and a ring if it is followed. */
  #drawRobot(robot, state, followedRobot) {
    const { context, history, radius, pixelRatio } = this;
    const [x, y] = this.centres[robot];
    const isFlawed = this.flawedRobots.has(robot);
    const isLost = history.robotsOnceLost.has(robot) && Number.isNaN(history.value("b_hat", robot, state));
    context.globalAlpha = isLost ? 0.4 : 1;
    context.beginPath();
    context.arc(x, y, radius, 0, FULL_TURN);
    context.fillStyle = this.#colourOfRobot(robot, state);
    context.fill();
    context.lineWidth = Math.min((isFlawed ? 2.6 : 1) * pixelRatio, radius / 2);
    context.strokeStyle = colour(isFlawed ? "ink" : "card");
    context.stroke();
    if (robot === followedRobot) {
      context.beginPath();
      context.arc(x, y, radius + 4 * pixelRatio, 0, FULL_TURN);
      context.strokeStyle = colour("focus");
      context.lineWidth = 2.5 * pixelRatio;
      context.stroke();
    }
    this.#drawId(String(history.description.robots[robot]), x, y);
    context.globalAlpha = 1;
  }

  #colourOfRobot(robot, state) {
    const specialColour = this.specialColours.get(robot);
    if (specialColour !== undefined) return colour(specialColour);
    return colourOfError(this.history.bHatError(robot, state));
  }

  /** Writes an id into a robot's body, if it fits there in letters that are large enough to read. */
  #drawId(id, x, y) {
    const { context, radius, pixelRatio } = this;
    const comfortableSize = Math.max(9 * pixelRatio, 0.95 * radius);
    const largestFittingSize = (1.45 * radius) / (0.6 * id.length);
    const fontSize = Math.min(comfortableSize, largestFittingSize);
    if (fontSize < 7 * pixelRatio) return;
    context.fillStyle = colour("card");
    context.font = `600 ${fontSize}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(id, x, y + 0.5 * pixelRatio);
  }

  /** Returns the robot at the position of a mouse event, or null. */
  robotAt({ offsetX, offsetY }) {
    const [mouseX, mouseY] = [offsetX * this.pixelRatio, offsetY * this.pixelRatio];
    const distances = this.centres.map(([x, y]) => Math.hypot(x - mouseX, y - mouseY));
    const nearestRobot = distances.indexOf(Math.min(...distances));
    const largestDistance = Math.max(1.6 * this.radius, 14 * this.pixelRatio);
    return distances[nearestRobot] < largestDistance ? nearestRobot : null;
  }
}

/** Shows the tiles in the middle of a floor in the legend, since on a screen they are smaller than pixels. */
function showTiles(floorImage) {
  const { width, height } = findElement("tiles");
  const left = (floorImage.width - width) >> 1;
  const top = (floorImage.height - height) >> 1;
  findElement("tiles").getContext("2d").drawImage(floorImage, -left, -top);
}

/** Returns a canvas with the floor, one pixel for each tile. */
function paintFloor({ rows, columns, bits }) {
  const canvas = document.createElement("canvas");
  canvas.width = columns;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  context.fillStyle = colour("white-tile");
  context.fillRect(0, 0, columns, rows);
  context.fillStyle = colour("black-tile");
  const bytesPerRow = Math.ceil(columns / 8);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const byte = bits[row * bytesPerRow + (column >> 3)];
      const isBlack = (byte >> (7 - (column & 7))) & 1; // the first tile is the highest bit
      if (isBlack) context.fillRect(column, row, 1, 1);
    }
  }
  return canvas;
}
