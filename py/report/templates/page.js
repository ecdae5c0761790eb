(function () {
  "use strict";
  const config = { responsive: true, displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };

  const narrow = window.innerWidth < 640;
  if (narrow) config.displayModeBar = false;

  function draw(plot) {
    if (plot.dataset.drawn) return;
    plot.dataset.drawn = "begun";
    const spec = JSON.parse(plot.parentElement.querySelector("script").textContent);
    if (narrow) Object.assign(spec.layout.margin, { l: 48, r: 8 });
    Plotly.newPlot(plot, spec.data, spec.layout, config).then(function () { plot.dataset.drawn = "yes"; });
  }

  function visible(plot) { return !plot.parentElement.hidden; }

  function choose(group, index) {
    group.querySelectorAll("button").forEach(function (button, k) { button.setAttribute("aria-selected", String(k === index)); });
    group.querySelectorAll("figure").forEach(function (figure, k) {
      figure.hidden = k !== index;
      if (k === index) draw(figure.querySelector(".plot"));
    });
  }

  const plots = Array.from(document.querySelectorAll(".plot"));
  document.querySelectorAll(".group").forEach(function (group) {
    const buttons = Array.from(group.querySelectorAll("button"));
    buttons.forEach(function (button, k) {
      button.addEventListener("click", function () { choose(group, k); });
      button.addEventListener("keydown", function (event) {
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (!step) return;
        const next = (k + step + buttons.length) % buttons.length;
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

  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (part) { part.open = true; });
    plots.filter(visible).forEach(draw);
    plots.filter(function (plot) { return plot.dataset.drawn; }).forEach(function (plot) { Plotly.Plots.resize(plot); });
  });
})();
