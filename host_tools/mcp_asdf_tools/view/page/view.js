// The view: everything that shows a history, and the controls of a user.

import { Arena } from "view/arena";
import { Bus } from "view/bus";
import { Charts, chartsOf } from "view/charts";
import { clearColours } from "view/colours";
import { findElement, showEvents, showFigures, showRobot, writeText } from "view/panels";
import { Player } from "view/player";
import { describeWaiting, formatPercent, introduceRun } from "view/words";

const MILLISECONDS_BETWEEN_ADDRESSES = 500; // browsers refuse addresses that change too often
const MILLISECONDS_BETWEEN_CHARTS = 250;
const LONGEST_FRAME_SECONDS = 0.25; // a page that was hidden does not jump ahead
const ARROW_DIRECTIONS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };

export class View {
  /** Creates a view without a history; `keepsAddress` is whether its address has the step and the robot. */
  constructor({ keepsAddress }) {
    this.keepsAddress = keepsAddress;
    this.player = new Player();
    this.arena = new Arena(findElement("arena"));
    this.charts = new Charts(findElement("charts"));
    this.bus = new Bus((id) => this.followRobot(this.#indexOfRobot(id)));
    this.history = null;
    this.isLive = false;
    this.followedRobot = null;
    this.onDraw = () => {}; // called with each state that is drawn
    this.lastFrameTime = performance.now();
    this.nextChartTime = 0;
    this.nextAddressTime = 0;
    this.#connectControls();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    window.view = this; // for the console, and for tests
    requestAnimationFrame((now) => this.#drawFrame(now));
  }

  /** Shows another history, by its own charts or by the given ones. */
  show(history, charts = chartsOf(history)) {
    this.history = history;
    this.arena.show(history);
    this.charts.show(history, charts);
    if (this.followedRobot !== null && this.followedRobot >= history.robotCount) this.followedRobot = null;
    this.charts.follow(this.followedRobot);
    findElement("title").textContent = history.description.title;
    document.title = `${history.description.title} – mcp-asdf`;
    this.#showIntroduction();
    const faults = history.description.faults ?? [];
    findElement("faults").textContent = faults.map(([text]) => text).join("; ");
    findElement("events").dataset.end = "";
  }

  #showIntroduction() {
    const { description } = this.history;
    const truth = description.fill_ratio;
    const [introduction, truthText] = findElement("about").children;
    introduction.textContent = introduceRun(description);
    truthText.textContent = truth === null ? "" : ` The truth is ${formatPercent(truth)}.`;
  }

  /** Shows what a page without any data waits for; hides that as soon as there are data. */
  showWaiting(text = describeWaiting(this.history.description)) {
    const hasData = this.history?.stateCount > 0 || this.bus.tableRows.size > 0;
    findElement("waiting").textContent = text;
    findElement("waiting").hidden = hasData;
    findElement("play").disabled = !hasData;
  }

  /** Appends a block of states to the history. */
  async appendBlock(block) {
    await this.history.appendBlock(block);
    this.player.end = this.history.lastTick;
    this.showWaiting();
    this.scheduleCharts(MILLISECONDS_BETWEEN_CHARTS);
  }

  /** Has the charts drawn again after some milliseconds, unless they are to be drawn earlier anyway. */
  scheduleCharts(milliseconds) {
    this.nextChartTime = Math.min(this.nextChartTime, performance.now() + milliseconds);
  }

  /** The length of the run in steps, as far as it is known; at least 1. */
  get totalSteps() {
    const describedSteps = this.isLive ? 0 : (this.history.description.steps ?? 0);
    return Math.max(this.history.lastTick, describedSteps, 1);
  }

  /** Chooses the speed at which a run of some steps takes about half a minute. */
  chooseSpeed(steps) {
    this.player.speed = Player.speedFor(steps);
    findElement("speed").value = String(this.player.speed);
  }

  /** Draws everything in the colours of a light or a dark page. */
  recolour() {
    clearColours();
    this.arena.recolour();
    this.charts.recolour();
  }

  /** Follows a robot by its index; null ends that. */
  followRobot(robot) {
    this.followedRobot = robot;
    this.charts.follow(robot);
    this.bus.follow(robot === null ? undefined : this.history.description.robots[robot]);
  }

  /** Returns the index of the robot with an id; null if there is none. */
  #indexOfRobot(id) {
    const index = this.history.description.robots.indexOf(id);
    return index === -1 ? null : index;
  }

  /** Draws one frame of the screen, and asks the browser for the next one. */
  #drawFrame(now) {
    const seconds = Math.min((now - this.lastFrameTime) / 1000, LONGEST_FRAME_SECONDS);
    this.lastFrameTime = now;
    if (this.history !== null && this.history.stateCount > 0) {
      this.player.advance(seconds);
      this.#drawIfChanged();
      this.#writeAddress(now);
      if (now >= this.nextChartTime) {
        this.charts.update();
        this.nextChartTime = Number.POSITIVE_INFINITY;
      }
    }
    requestAnimationFrame((next) => this.#drawFrame(next));
  }

  /** Goes where an address such as #step=300&robot=7 leads; returns whether it has a step. */
  openAddress() {
    const parameters = new URLSearchParams(location.hash.slice(1));
    if (parameters.has("robot")) this.followRobot(this.#indexOfRobot(Number(parameters.get("robot"))));
    const step = Number.parseFloat(parameters.get("step"));
    const hasStep = Number.isFinite(step);
    if (hasStep) this.player.seek(step);
    return hasStep;
  }

  /** Writes step and robot into the address, so that a link shows what this user sees. */
  #writeAddress(now) {
    const isFramed = parent !== window;
    if (!this.keepsAddress || isFramed || now < this.nextAddressTime) return;
    this.nextAddressTime = now + MILLISECONDS_BETWEEN_ADDRESSES;
    const parts = [];
    if (!this.player.isFollowing) parts.push(`step=${Math.floor(this.player.tick)}`);
    if (this.followedRobot !== null) {
      parts.push(`robot=${this.history.description.robots[this.followedRobot]}`);
    }
    const address = parts.join("&");
    if (address !== location.hash.slice(1)) window.history.replaceState(null, "", `#${address}`);
  }

  /** Goes to the next event (direction 1) or to the one before (-1), if there is one. */
  #seekEvent(direction) {
    if (this.history === null) return;
    const { tick } = this.player;
    const event =
      direction > 0
        ? this.history.events.find((candidate) => candidate.tick > tick)
        : this.history.events.findLast((candidate) => candidate.tick < tick);
    if (event === undefined) return;
    this.player.pause();
    this.#openEvent(event);
  }

  #openEvent(event) {
    this.player.seek(event.tick);
    this.followRobot(event.robot ?? this.followedRobot);
  }

  /** Follows the next robot (direction 1) or the one before (-1), from the last on to the first. */
  #followNextRobot(direction) {
    const { robotCount } = this.history;
    if (this.followedRobot === null) {
      this.followRobot(direction > 0 ? 0 : robotCount - 1);
    } else {
      this.followRobot((this.followedRobot + direction + robotCount) % robotCount);
    }
  }

  /** Draws the present state, unless the screen shows it already. */
  #drawIfChanged() {
    const { history, player, followedRobot } = this;
    const { tick } = player;
    const areEventsUnderMouse = findElement("events").matches(":hover");
    const shownValues = [
      history,
      history.stateCount,
      tick,
      followedRobot,
      this.totalSteps,
      player.isPlaying,
      player.isFollowing,
      areEventsUnderMouse,
    ];
    const isUnchanged = shownValues.every((value, index) => value === this.lastShownValues?.[index]);
    if (isUnchanged && !this.arena.isBlank) return;
    this.lastShownValues = shownValues;
    const state = history.stateAt(tick);
    findElement("lost").hidden = history.description.steps !== null && history.robotsOnceLost.size === 0;
    this.arena.draw(tick, followedRobot);
    this.charts.markPresent(tick);
    showFigures(history, state);
    showRobot(history, state, followedRobot);
    showEvents(history, tick, (event) => this.#openEvent(event));
    this.#showTime(tick);
    this.onDraw(state);
  }

  #showTime(tick) {
    const { player, history } = this;
    findElement("time").max = this.totalSteps; // first, since the browser limits the value to it
    findElement("time").value = tick;
    const seconds = (tick / history.description.steps_per_second).toFixed(1);
    writeText(findElement("clock"), `step ${Math.floor(tick)} of ${this.totalSteps}, ${seconds} s`);
    writeText(findElement("play"), player.isMoving ? "❚❚ pause" : "▶ play");
    findElement("live").setAttribute("aria-pressed", String(player.isFollowing));
  }

  #connectControls() {
    const { player } = this;
    const timeSlider = findElement("time");
    const speedMenu = findElement("speed");
    for (const speed of Player.speeds) speedMenu.append(new Option(`${speed} steps/s`, String(speed)));
    speedMenu.addEventListener("change", () => {
      player.speed = Number(speedMenu.value);
    });
    timeSlider.addEventListener("input", () => player.seek(Number(timeSlider.value)));
    findElement("play").addEventListener("click", () => player.toggle());
    findElement("live").addEventListener("click", () => player.follow());
    findElement("earlier").addEventListener("click", () => this.#seekEvent(-1));
    findElement("later").addEventListener("click", () => this.#seekEvent(1));
    findElement("arena").addEventListener("click", (event) => this.followRobot(this.arena.robotAt(event)));
    document.addEventListener("keydown", (event) => this.#handleKey(event));
  }

  #handleKey(event) {
    if (this.history === null) return;
    const isInArena = event.target === findElement("arena");
    const isForControl = event.target.matches("select, button, input");
    const hasModifier = event.ctrlKey || event.metaKey || event.altKey;
    if (event.key === "Escape") this.followRobot(null);
    else if (isInArena && event.key in ARROW_DIRECTIONS) this.#followNextRobot(ARROW_DIRECTIONS[event.key]);
    else if (isForControl || hasModifier) return;
    else if (event.key === " ") this.player.toggle();
    else if (event.key === "n") this.#seekEvent(1);
    else if (event.key === "p") this.#seekEvent(-1);
    else return;
    event.preventDefault();
  }
}
