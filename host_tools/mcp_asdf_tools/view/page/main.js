// The start of a page: it shows the history that it holds, or else follows that of the server it comes from.

import { History } from "view/history";
import { findElement } from "view/panels";
import { View } from "view/view";

const STEPS_OF_UNKNOWN_LENGTH = 300; // for the speed of a run that has no end

function showStatus(text, isLive = false) {
  findElement("state").textContent = text;
  findElement("state").className = isLive ? "live" : "";
}

/** Shows a history that is over, and plays it unless the address has a step. */
async function openRecording(view, { description, block }) {
  view.show(await History.decode(description));
  await view.appendBlock(block);
  view.chooseSpeed(view.history.lastTick);
  showStatus("recorded");
  if (!view.openAddress()) view.player.play();
}

/** Follows the history of the server by its events, which view/server.py describes. */
function followServer(view) {
  const source = new EventSource("/events");
  let lastEvent = Promise.resolve();
  let hasOpenedAddress = false;

  function handleEvents(name, handle) {
    source.addEventListener(name, ({ data }) => {
      // Inflating a block takes a moment, so each event waits for the one before.
      lastEvent = lastEvent
        .then(() => handle(JSON.parse(data)))
        .catch((error) => showStatus(`the page failed: ${error.message}`));
    });
  }

  handleEvents("description", async (description) => {
    const isFirst = view.history === null;
    view.isLive = true;
    view.show(await History.decode(description));
    findElement("live").hidden = false;
    showStatus("live", true);
    view.showWaiting();
    if (isFirst) {
      view.chooseSpeed(description.steps ?? STEPS_OF_UNKNOWN_LENGTH);
      view.player.follow();
    }
  });
  handleEvents("block", async (block) => {
    await view.appendBlock(block);
    if (!hasOpenedAddress) view.openAddress();
    hasOpenedAddress = true;
  });
  handleEvents("report", (report) => {
    view.bus.showReport(report);
    view.showWaiting();
  });
  handleEvents("end", () => {
    view.isLive = false;
    findElement("live").hidden = true;
    showStatus("the run has ended");
    if (view.player.isFollowing) {
      view.player.seek(view.history.lastTick);
      view.player.pause();
    }
    view.showWaiting("the run has ended without any data");
  });
  source.addEventListener("end", () => source.close()); // or the browser would connect again
  source.addEventListener("error", () => showStatus("no connection; trying again"));
  view.showWaiting("waiting for the run");
}

const view = new View({ keepsAddress: true });
const recording = JSON.parse(findElement("history").textContent);
if (recording === null) followServer(view);
else openRecording(view, recording);
