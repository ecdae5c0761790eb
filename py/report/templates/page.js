(function () {
  "use strict";
  const config = { responsive: true, displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
  const narrow = window.innerWidth < 640;
  if (narrow) config.displayModeBar = false;

  const plots = Array.from(document.querySelectorAll(".plot"));
  let opened = null; /* the tables that were opened to be printed; null on a screen */
  const groups = Array.from(document.querySelectorAll(".group"));

  /* Plotly is unpacked when the first plot is drawn, and stays. */
  function library() {
    if (window.Plotly) return window.Plotly;
    const script = document.createElement("script");
    script.textContent = unpacked(document.querySelector("script.library"));
    document.head.append(script);
    return window.Plotly;
  }

  function draw(plot) {
    if (plot.dataset.drawn) return;
    plot.dataset.drawn = "begun";
    try {
      const spec = JSON.parse(unpacked(plot.parentElement.querySelector("script.spec")));
      if (narrow) Object.assign(spec.layout.margin, { l: 48, r: 8 });
      plot.dataset.height = spec.layout.height;
      spec.layout.height = height(plot);
      const thumb = plot.querySelector(".thumb");
      library();
      if (thumb) thumb.remove();
      library().newPlot(plot, spec.data, spec.layout, config).then(function () { name(plot); plot.dataset.drawn = "yes"; });
    } catch (error) {
      plot.dataset.drawn = "no";
      plot.textContent = "This browser cannot draw the plot; a newer one can. The tables are complete. (" + error.message + ")";
      console.error(error);
    }
  }

  /* The picture keeps the words; buttons beside it are no part of an image, and its own letters say nothing alone. */
  function name(plot) {
    const words = plot.getAttribute("aria-label");
    plot.querySelectorAll(".main-svg").forEach(function (part, k) {
      if (k) part.setAttribute("aria-hidden", "true");
      else { part.setAttribute("role", "img"); part.setAttribute("aria-label", words); }
    });
    plot.removeAttribute("role");
    plot.removeAttribute("aria-label");
  }

  function choose(group, index) {
    group.querySelectorAll("button[role=tab]").forEach(function (button, k) {
      button.setAttribute("aria-selected", String(k === index));
      button.tabIndex = k === index ? 0 : -1;
    });
    group.querySelectorAll("figure").forEach(function (figure, k) {
      figure.hidden = k !== index;
      if (k === index) draw(figure.querySelector(".plot"));
    });
  }

  groups.forEach(function (group) {
    const buttons = Array.from(group.querySelectorAll("button[role=tab]"));
    buttons.forEach(function (button, k) {
      button.addEventListener("click", function () { choose(group, k); });
      button.addEventListener("keydown", function (event) {
        const last = buttons.length - 1;
        const next = { ArrowRight: k < last ? k + 1 : 0, ArrowLeft: k ? k - 1 : last, Home: 0, End: last }[event.key];
        if (next === undefined) return;
        event.preventDefault();
        choose(group, next);
        buttons[next].focus();
      });
    });
  });

  const seen = new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) {
      if (!entry.isIntersecting) return;
      seen.unobserve(entry.target);
      draw(entry.target);
    });
  }, { rootMargin: "600px" });
  plots.forEach(function (plot) { seen.observe(plot); });

  /* What is wider than its place is scrolled with the keyboard too. */
  const fits = new ResizeObserver(function (entries) {
    entries.forEach(function (entry) {
      const wide = entry.target.scrollWidth > entry.target.clientWidth;
      if (wide) entry.target.tabIndex = 0;
      else entry.target.removeAttribute("tabindex");
    });
  });
  document.querySelectorAll(".scroll").forEach(function (part) { fits.observe(part); });

  /* On paper there is nothing to click: every tab and every folded table is shown, as wide as the paper. */
  const HALF_PAGE = 440; /* px: two plots with their captions on a page of A4 */
  function height(plot) {
    const own = Number(plot.dataset.height);
    const now = opened ? Math.min(own, HALF_PAGE) : own;
    plot.style.height = now + "px";
    return now;
  }
  function fit() {
    plots.forEach(function (plot) {
      if (!plot.dataset.drawn || plot.dataset.drawn === "no" || !plot.offsetWidth) return;
      height(plot);
      window.Plotly.Plots.resize(plot); /* takes the size of its place */
    });
  }
  function print() {
    if (opened) return;
    opened = Array.from(document.querySelectorAll("details:not([open])"));
    opened.forEach(function (part) { part.open = true; });
    document.documentElement.classList.add("printing");
    fit();
    plots.forEach(draw);
  }
  function printed() {
    if (!opened) return;
    opened.forEach(function (part) { part.open = false; });
    opened = null;
    document.documentElement.classList.remove("printing");
    fit();
  }
  window.addEventListener("beforeprint", print);
  window.addEventListener("afterprint", printed);
  window.matchMedia("print").addEventListener("change", function (event) { if (event.matches) print(); else printed(); });
})();
