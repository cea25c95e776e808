// The page: a film from the page itself or from the server, and everything that shows it.

import { Arena } from "view/arena";
import { Charts } from "view/charts";
import { setTheme } from "view/colours";
import { Film } from "view/film";
import { showEvents, showFigures, showLegend, showMarks, showRobot } from "view/panels";
import { Player } from "view/player";

const MILLISECONDS_BETWEEN_CHARTS = 250;
const SECONDS_OF_AN_UPDATE = 0.9;

const find = (id) => document.getElementById(id);

class View {
  constructor() {
    this.player = new Player();
    this.arena = new Arena(find("arena"));
    this.charts = new Charts(find("charts"), (tick) => this.player.seek(tick));
    this.film = null;
    this.events = [];
    this.chosen = null;
    this.flow = 0;
    this.before = performance.now();
    this.chartsDue = 0;
    this.connectControls();
  }

  /** Shows another film, from its start. */
  show(film) {
    this.film = film;
    this.events = [];
    this.searched = 0;
    this.arena.show(film);
    this.charts.show(film);
    if (this.chosen !== null && this.chosen >= film.robots) this.chosen = null;
    this.charts.follow(this.chosen);
    find("title").textContent = film.stage.title;
    document.title = `${film.stage.title} – mcp-asdf`;
    find("events").dataset.end = find("robot").dataset.robot = "";
    showLegend(find("legend"), film);
  }

  /** Takes a block of samples. */
  async append(block) {
    await this.film.append(block);
    this.film.events(this.searched, this.events);
    this.searched = this.film.length;
    this.player.end = this.film.lastTick;
    find("time").max = this.total;
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

  follow(robot) {
    this.chosen = robot;
    this.charts.follow(robot);
  }

  /** One frame of the screen. */
  frame(now) {
    const seconds = Math.min((now - this.before) / 1000, 0.25);
    this.before = now;
    const { film, player } = this;
    if (film?.length) {
      player.advance(seconds);
      if (player.isPlaying || player.isFollowing) this.flow += seconds;
      const start = performance.now();
      this.draw();
      this.drawSeconds = (performance.now() - start) / 1000;
      if (now >= this.chartsDue) {
        this.charts.update();
        showMarks(find("marks"), film, this.events, this.total);
        this.chartsDue = Number.POSITIVE_INFINITY;
      }
      this.frames = (this.frames ?? 0) + 1;
    }
    requestAnimationFrame((next) => this.frame(next));
  }

  draw() {
    const { film, player } = this;
    const { tick } = player;
    const sample = film.sampleAt(tick);
    const stepsPerSecond = player.isPlaying
      ? player.speed
      : player.isFollowing
        ? Number.POSITIVE_INFINITY
        : 0;
    const recent = this.recentUpdates(tick, player.isFollowing ? 200 : player.speed * SECONDS_OF_AN_UPDATE);
    this.arena.draw(tick, { flow: this.flow, stepsPerSecond, chosen: this.chosen, recent });
    this.charts.mark(tick);
    showFigures(find("figures"), film, sample);
    showRobot(find("robot"), film, sample, this.chosen, () => this.follow(null));
    showEvents(find("events"), film, this.events, tick, (event) => {
      player.seek(event.tick);
      this.follow(event.robot);
    });
    this.showTime(tick);
  }

  /** Robots that have recalibrated in the last so many steps, with how long ago as a share of these. */
  recentUpdates(tick, span) {
    const found = [];
    for (let i = this.events.findLastIndex((event) => event.tick <= tick); i >= 0; i--) {
      const age = (tick - this.events[i].tick) / span;
      if (age > 1) break;
      found.push({ robot: this.events[i].robot, age });
    }
    return found;
  }

  showTime(tick) {
    const { player, film } = this;
    const { stepsPerSecond } = film.stage;
    find("time").value = tick;
    find("time").max = this.total;
    const text = `step ${Math.floor(tick)} of ${this.total}, ${(tick / stepsPerSecond).toFixed(1)} s`;
    if (find("clock").textContent !== text) find("clock").textContent = text;
    const sign = player.isPlaying ? "❚❚" : "▶";
    if (find("play").textContent !== sign) find("play").textContent = sign;
    find("live").setAttribute("aria-pressed", String(player.isFollowing));
  }

  togglePlay() {
    if (this.player.isPlaying) this.player.pause();
    else this.player.play();
  }

  connectControls() {
    find("play").addEventListener("click", () => this.togglePlay());
    find("live").addEventListener("click", () => this.player.follow());
    find("time").addEventListener("input", () => this.player.seek(Number(find("time").value)));
    find("theme").addEventListener("click", () => this.changeTheme());
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
    if (event.target instanceof HTMLSelectElement || event.target instanceof HTMLInputElement) return;
    const step = this.film?.length > 1 ? this.film.ticks[1] - this.film.ticks[0] : 1;
    const actions = {
      " ": () => this.togglePlay(),
      ArrowLeft: () => this.player.seek(this.player.tick - step),
      ArrowRight: () => this.player.seek(this.player.tick + step),
      Home: () => this.player.seek(0),
      End: () => (this.isLive ? this.player.follow() : this.player.seek(this.player.end)),
      Escape: () => this.follow(null),
    };
    const action = actions[event.key];
    if (!action || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
    event.preventDefault();
    action();
  }

  changeTheme(name) {
    setTheme(name);
    this.arena.repaint();
    this.charts.repaint();
    this.charts.follow(this.chosen);
    if (this.film) showMarks(find("marks"), this.film, this.events, this.total);
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
  view.player.play();
}

/** Shows a run as it goes. Blocks are taken one after the other, since unpacking one takes a moment. */
function connect(view) {
  let queue = Promise.resolve();
  const then = (action) => {
    queue = queue.then(action).catch((error) => say(`the page failed: ${error.message}`));
  };
  const source = new EventSource("/events");
  source.addEventListener("stage", (event) =>
    then(async () => {
      const isFirst = view.film === null;
      view.isLive = true;
      view.show(await Film.on(JSON.parse(event.data)));
      find("live").hidden = false;
      say("live", true);
      if (isFirst) {
        view.chooseSpeed(view.film.stage.steps ?? 300);
        view.player.follow();
      }
    }),
  );
  source.addEventListener("block", (event) => then(() => view.append(JSON.parse(event.data))));
  source.addEventListener("end", () => {
    source.close();
    then(() => {
      view.isLive = false;
      find("live").hidden = true;
      say("the run has ended");
      view.chooseSpeed(view.film.lastTick);
      if (view.player.isFollowing) view.player.pause();
    });
  });
  source.addEventListener("error", () => say("no connection; trying again"));
}

async function main() {
  setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  const view = new View();
  window.view = view; // for the console, and for tests
  requestAnimationFrame((now) => view.frame(now));
  const content = JSON.parse(find("film").textContent);
  if (content === null) connect(view);
  else await open(view, content);
}

main();
