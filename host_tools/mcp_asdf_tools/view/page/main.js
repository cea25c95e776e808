// The page: a film from the page itself or from the server, and everything that shows it.

import { Arena } from "view/arena";
import { Bus } from "view/bus";
import { Charts } from "view/charts";
import { forgetColours } from "view/colours";
import { Film } from "view/film";
import { find, showEvents, showFigures, showMarks, showRobot, write } from "view/panels";
import { Player } from "view/player";
import { Playground } from "view/playground";

const MILLISECONDS_BETWEEN_ADDRESSES = 500;
const MILLISECONDS_BETWEEN_CHARTS = 250;

const WAYS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };

class View {
  constructor() {
    this.player = new Player();
    this.arena = new Arena(find("arena"));
    this.charts = new Charts(find("charts"));
    this.bus = new Bus((id) => this.follow(this.film.stage.robots.indexOf(id)));
    this.film = null;
    this.chosen = null;
    this.before = performance.now();
    this.chartsDue = 0;
    this.addressDue = 0;
    this.connectControls();
  }

  /** Shows another film, from its start. */
  show(film) {
    this.film = film;
    this.arena.show(film);
    this.charts.show(film);
    if (this.chosen !== null && this.chosen >= film.robots) this.chosen = null;
    this.charts.follow(this.chosen);
    find("title").textContent = film.stage.title;
    document.title = `${film.stage.title} – mcp-asdf`;
    find("faults").textContent = (film.stage.faults ?? []).map(([text]) => text).join("; ");
    find("marks").dataset.key = "";
    find("events").dataset.end = "";
  }

  /** Takes a block of samples. */
  async append(block) {
    await this.film.append(block);
    this.player.end = this.film.lastTick;
    this.chartsDue = Math.min(this.chartsDue, performance.now() + MILLISECONDS_BETWEEN_CHARTS);
  }

  /** Steps of the whole run as far as they are known. */
  get total() {
    const known = this.isLive ? 0 : (this.film.stage.steps ?? 0);
    return Math.max(this.film.lastTick, known, 1);
  }

  chooseSpeed(steps) {
    this.player.speed = Player.speedFor(steps);
    find("speed").value = String(this.player.speed);
  }

  /** Takes the colours of a light or a dark page. */
  recolour() {
    forgetColours();
    find("marks").dataset.key = "";
    this.arena.recolour();
    this.charts.rebuild();
  }

  /** Follows a robot, by its place among them; null or -1 for none. */
  follow(robot) {
    this.chosen = robot === -1 ? null : robot;
    this.charts.follow(this.chosen);
    this.bus.follow(this.film.stage.robots[this.chosen]);
  }

  /** One frame of the screen. */
  frame(now) {
    const seconds = Math.min((now - this.before) / 1000, 0.25);
    this.before = now;
    const { film, player } = this;
    if (film?.length) {
      player.advance(seconds);
      this.draw();
      this.showAddress(now);
      if (now >= this.chartsDue) {
        this.charts.update();
        this.chartsDue = Number.POSITIVE_INFINITY;
      }
    }
    requestAnimationFrame((next) => this.frame(next));
  }

  /** Goes to the step and follows the robot of an address such as #step=300&robot=7; false if it has no step. */
  openAddress() {
    const settings = new URLSearchParams(location.hash.slice(1));
    if (settings.has("robot")) this.follow(this.film.stage.robots.indexOf(Number(settings.get("robot"))));
    const step = Number.parseFloat(settings.get("step"));
    if (Number.isFinite(step)) this.player.seek(step);
    return Number.isFinite(step);
  }

  /** Keeps step and robot in the address, so that a link shows what one sees. A page in another has none. */
  showAddress(now) {
    if (this.playground || parent !== window || now < this.addressDue) return;
    this.addressDue = now + MILLISECONDS_BETWEEN_ADDRESSES; // browsers refuse addresses that change too often
    const robot = this.chosen === null ? "" : `&robot=${this.film.stage.robots[this.chosen]}`;
    const address = this.player.isFollowing ? robot.slice(1) : `step=${Math.floor(this.player.tick)}${robot}`;
    if (address !== location.hash.slice(1)) history.replaceState(null, "", `#${address}`);
  }

  /** Goes to the next event, or with -1 to the one before. */
  seekEvent(way) {
    if (!this.film) return;
    const events = way > 0 ? this.film.events : [...this.film.events].reverse();
    const next = events.find(({ tick }) => way * (tick - this.player.tick) > 0);
    if (!next) return;
    this.player.pause();
    this.player.seek(next.tick);
    this.follow(next.robot ?? this.chosen);
  }

  /** Follows the next robot, or with -1 the one before. */
  step(way) {
    const { robots } = this.film;
    this.follow(this.chosen === null ? (way > 0 ? 0 : robots - 1) : (this.chosen + way + robots) % robots);
  }

  draw() {
    const { film, player } = this;
    const { tick } = player;
    const isHeld = find("events").matches(":hover");
    const playing = [player.isPlaying, player.isFollowing, isHeld];
    const state = [film, film.length, tick, this.chosen, this.total, ...playing];
    if (!this.arena.isBlank && state.every((each, index) => each === this.drawn?.[index])) return;
    this.drawn = state;
    const sample = film.sampleAt(tick);
    this.arena.draw(tick, this.chosen);
    this.charts.mark(tick);
    showFigures(film, sample);
    showRobot(film, sample, this.chosen);
    showEvents(film, tick, (event) => {
      player.seek(event.tick);
      this.follow(event.robot ?? this.chosen);
    });
    showMarks(film, this.total);
    this.showTime(tick);
  }

  showTime(tick) {
    const { player, film } = this;
    find("time").value = tick;
    find("time").max = this.total;
    const seconds = (tick / film.stage.steps_per_second).toFixed(1);
    write(find("clock"), `step ${Math.floor(tick)} of ${this.total}, ${seconds} s`);
    write(find("play"), player.isPlaying ? "❚❚" : "▶");
    find("live").setAttribute("aria-pressed", String(player.isFollowing));
  }

  connectControls() {
    find("play").addEventListener("click", () => this.player.toggle());
    find("live").addEventListener("click", () => this.player.follow());
    find("earlier").addEventListener("click", () => this.seekEvent(-1));
    find("later").addEventListener("click", () => this.seekEvent(1));
    find("time").addEventListener("input", () => this.player.seek(Number(find("time").value)));
    find("arena").addEventListener("click", (event) => this.follow(this.arena.robotAt(event)));
    for (const speed of Player.speeds) {
      find("speed").append(new Option(`${speed} steps/s`, String(speed)));
    }
    find("speed").addEventListener("change", () => {
      this.player.speed = Number(find("speed").value);
    });
    document.addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    const isTyped = event.target.matches("select, button, input");
    if (!this.film) return;
    if (event.key === "Escape") this.follow(null);
    else if (event.target === find("arena") && event.key in WAYS) this.step(WAYS[event.key]);
    else if (isTyped || event.ctrlKey || event.metaKey || event.altKey) return;
    else if (event.key === " ") this.player.toggle();
    else if (event.key === "n") this.seekEvent(1);
    else if (event.key === "p") this.seekEvent(-1);
    else return;
    event.preventDefault();
  }
}

function say(text, isLive = false) {
  find("state").textContent = text;
  find("state").className = isLive ? "live" : "";
}

/** Shows the film that the page holds, and plays it. */
async function open(view, { stage, block }) {
  view.show(await Film.on(stage));
  await view.append(block);
  view.chooseSpeed(view.film.lastTick);
  say("recorded");
  if (!view.openAddress()) view.player.play();
}

/** Shows a run as it goes. Blocks are taken one after the other, since unpacking one takes a moment. */
function connect(view) {
  const source = new EventSource("/events");
  let queue = Promise.resolve();
  const take = (name, action) =>
    source.addEventListener(name, ({ data }) => {
      queue = queue
        .then(() => action(JSON.parse(data)))
        .catch((error) => say(`the page failed: ${error.message}`));
    });
  take("stage", async (stage) => {
    const isFirst = view.film === null;
    view.isLive = true;
    view.show(await Film.on(stage));
    find("live").hidden = false;
    say("live", true);
    if (isFirst) {
      view.chooseSpeed(stage.steps ?? 300);
      view.player.follow();
    }
  });
  let isOpened = false;
  take("block", async (block) => {
    await view.append(block);
    if (!isOpened) view.openAddress();
    isOpened = true;
  });
  take("report", (report) => view.bus.take(report));
  take("end", () => {
    view.isLive = false;
    find("live").hidden = true;
    say("the run has ended");
    if (view.player.isFollowing) view.player.pause();
  });
  source.addEventListener("end", () => source.close());
  source.addEventListener("error", () => say("no connection; trying again"));
}

async function main() {
  const view = new View();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.recolour());
  window.view = view; // for the console, and for tests
  requestAnimationFrame((now) => view.frame(now));
  const content = JSON.parse(find("film").textContent);
  if (content === null) connect(view);
  else if (content.module) view.playground = new Playground(view, content.module);
  else await open(view, content);
}

main();
