// A page opened as a file may not read other files: the search then lists titles without excerpts.
if (location.protocol === "file:") DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;

// Paper is white, whatever the screen is.
(function () {
  const root = document.documentElement;
  let theme;
  addEventListener("beforeprint", function () {
    theme = root.dataset.theme;
    root.dataset.theme = "light";
  });
  addEventListener("afterprint", function () {
    root.dataset.theme = theme;
  });
})();

// What is wider than its box scrolls there: also by the arrow keys, once it can be focused.
(function () {
  const WIDE = "pre, .text_html div, mjx-container[display=true], [class*=table-container]";
  function reachable() {
    for (const box of document.querySelectorAll(WIDE)) {
      if (!box.closest("article") || box.hasAttribute("tabindex")) continue;
      const scrolls = ["auto", "scroll"].includes(getComputedStyle(box).overflowX);
      if (scrolls && box.scrollWidth > box.clientWidth + 1) box.tabIndex = 0;
    }
  }
  addEventListener("load", function () {
    reachable();
    if (window.MathJax && MathJax.startup) MathJax.startup.promise.then(reachable);
  });
  addEventListener("resize", reachable);
})();

// A figure that the page shrinks grows to its own size at a tap, and then scrolls in its own box.
(function () {
  const SHRUNK = 0.85; // of its size; what is nearly whole needs no button
  function framed(picture) {
    const frame = document.createElement("span");
    const view = document.createElement("span");
    const button = document.createElement("button");
    frame.className = "figure-frame";
    view.className = "figure-view";
    button.className = "figure-size";
    button.type = "button";
    picture.before(frame);
    view.append(picture);
    frame.append(view, button);
    function fit() {
      const enlarged = frame.classList.contains("enlarged");
      const shrunk = picture.clientWidth < SHRUNK * picture.naturalWidth;
      frame.classList.toggle("shrunk", !enlarged && shrunk);
      button.hidden = !enlarged && !shrunk;
      button.textContent = enlarged ? "Fit to the page" : "Enlarge";
      button.setAttribute("aria-expanded", String(enlarged));
      if (enlarged) view.tabIndex = 0;
      else view.removeAttribute("tabindex");
    }
    function turn() {
      const enlarged = frame.classList.toggle("enlarged");
      picture.style.width = enlarged ? picture.naturalWidth + "px" : "";
      fit();
    }
    button.addEventListener("click", turn);
    picture.addEventListener("click", function () {
      if (!button.hidden) turn();
    });
    picture.addEventListener("load", fit);
    addEventListener("resize", fit);
    fit();
  }
  addEventListener("DOMContentLoaded", function () {
    document.querySelectorAll("article .cell_output p > img").forEach(framed);
  });
})();
