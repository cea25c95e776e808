// The frame of the playground on the first page: it gets this page's address and colours, the height that it needs, and
// the height of a screen, into which its floor and its controls fit.
const SMALLEST_HEIGHT = 600; // in pixels, of a screen below the text above the frame
const frame = document.getElementById("playground");
if (frame) {
  const send = (message) => frame.contentWindow.postMessage(message, "*");
  const sendTheme = () => send({ theme: document.body.dataset.mdColorScheme === "slate" ? "dark" : "light" });
  const sendScreen = () => {
    const headerHeight = document.querySelector(".md-header")?.offsetHeight ?? 0;
    const heightBelowText = innerHeight - frame.getBoundingClientRect().top - scrollY;
    // On a small screen a visitor has to scroll to the frame, and then sees only that.
    const fitsBelowText = heightBelowText >= SMALLEST_HEIGHT;
    send({ screen: Math.floor(fitsBelowText ? heightBelowText : innerHeight - headerHeight) });
  };
  const hasSettings = () => location.hash.includes("=");
  frame.src = `play.html${hasSettings() ? location.hash : ""}`;
  addEventListener("message", ({ data, source }) => {
    if (source !== frame.contentWindow) return;
    if (data.isReady) {
      sendTheme();
      sendScreen();
    }
    if (data.height) frame.style.height = `${data.height}px`;
    if (data.address) history.replaceState(null, "", data.address);
  });
  addEventListener("resize", sendScreen);
  addEventListener("hashchange", () => {
    if (hasSettings()) send({ address: location.hash });
  });
  new MutationObserver(sendTheme).observe(document.body, { attributeFilter: ["data-md-color-scheme"] });
}
