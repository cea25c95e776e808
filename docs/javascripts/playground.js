// The frame of the playground on the first page: it gets this page's address and colours, and the height it needs.
const frame = document.getElementById("playground");
if (frame) {
  const send = (message) => frame.contentWindow.postMessage(message, "*");
  const sendTheme = () => send({ theme: document.body.dataset.mdColorScheme === "slate" ? "dark" : "light" });
  const hasSettings = () => location.hash.includes("=");
  frame.src = `play.html${hasSettings() ? location.hash : ""}`;
  addEventListener("message", ({ data, source }) => {
    if (source !== frame.contentWindow) return;
    if (data.isReady) sendTheme();
    if (data.height) frame.style.height = `${data.height}px`;
    if (data.address) history.replaceState(null, "", data.address);
  });
  addEventListener("hashchange", () => {
    if (hasSettings()) send({ address: location.hash });
  });
  new MutationObserver(sendTheme).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
}
