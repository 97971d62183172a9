// Draws the curves that report/chart.py wrote into the page, to zoom and to read values from.
const floats = text => new Float64Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const plainNumber = x => {
  const size = Math.abs(x);
  const known = Number(x.toPrecision(5));
  return size && (size < 1e-4 || size >= 1e6) ? known.toExponential() : String(known);
};

function drawChart(stage, given) {
  const root = stage.querySelector(".chart");
  const canvas = element("canvas", element("div", root, { className: "frame" }));
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", given.alt);
  const xs = given.axes.map(floats);
  const datasets = given.curves.map(c => {
    const x = xs[c.x], y = floats(c.y);
    return {
      given: c, label: c.name, borderDash: c.dash, borderWidth: c.width || 1.2, showLine: c.width > 0,
      pointStyle: c.mark, pointRadius: c.mark ? 4 : 0, pointHitRadius: 8,
      data: Array.from(x, (value, i) => ({ x: value, y: y[i] })),
    };
  });
  const scale = (log, text) => ({
    type: log ? "logarithmic" : "linear", title: { display: true, text },
    bounds: "data", ticks: { callback: plainNumber, maxTicksLimit: 9 },
  });
  const chart = new Chart(canvas, {
    type: "scatter",
    data: { datasets },
    options: {
      animation: false, maintainAspectRatio: false,
      interaction: { mode: "nearest", intersect: false, axis: "xy" },
      scales: { x: scale(given.log[0], given.xlabel), y: scale(given.log[1], given.panels[0]) },
      plugins: {
        zoom: { zoom: { drag: { enabled: true }, wheel: { enabled: true, modifierKey: "ctrl" }, mode: "xy" } },
        legend: { labels: { usePointStyle: true, pointStyle: "line" }, onClick: (_, item) => {
          const name = item.text, shown = chart.isDatasetVisible(item.datasetIndex);
          datasets.forEach((d, i) => {
            if (d.label === name && d.given.panel === panel) chart.setDatasetVisibility(i, !shown);
          });
          chart.update();
        } },
        tooltip: { filter: (item, i, all) => all.findIndex(o => o.dataset.label === item.dataset.label
          && o.parsed.x === item.parsed.x) === i, callbacks: { label: item =>
          `${item.dataset.label}: ${plainNumber(item.parsed.y)} at ${plainNumber(item.parsed.x)}` } },
      },
    },
  });
  let panel = 0;
  const show = number => {
    panel = number;
    datasets.forEach((d, i) => chart.setDatasetVisibility(i, d.given.panel === panel));
    chart.options.scales.y.title.text = given.panels[panel];
    chart.options.plugins.legend.labels.filter = item => {
      const d = datasets[item.datasetIndex];
      return d.given.panel === panel
        && datasets.findIndex(o => o.label === d.label && o.given.panel === panel) === item.datasetIndex;
    };
    chart.resetZoom("none");
    chart.update();
  };
  const row = element("div", root, { className: "tools" });
  if (given.panels.length > 1) {
    const label = element("label", row, { textContent: "Show " }), list = element("select", label);
    given.panels.forEach((words, i) => element("option", list, { value: i, textContent: words }));
    list.onchange = () => show(Number(list.value));
  }
  for (const axis of ["x", "y"]) {
    const label = element("label", row), box = element("input", label, { type: "checkbox" });
    box.checked = chart.options.scales[axis].type === "logarithmic";
    label.append(` log ${axis}`);
    box.onchange = () => {
      chart.options.scales[axis].type = box.checked ? "logarithmic" : "linear";
      chart.resetZoom("none");
      chart.update();
    };
  }
  const press = (text, act) => {
    element("button", row, { type: "button", textContent: text }).onclick = act;
  };
  press("Whole range", () => chart.resetZoom());
  press("Picture", () => save(canvas.toDataURL("image/png"), `${given.file}.png`));
  press("CSV", () => {
    const rows = datasets.flatMap((d, i) => !chart.isDatasetVisible(i) ? [] : d.data.map(p =>
      [JSON.stringify(d.label), p.x, Number.isNaN(p.y) ? "" : p.y].join(",")));
    const head = ["curve", JSON.stringify(given.xlabel), JSON.stringify(given.panels[panel])].join(",");
    const text = encodeURIComponent([head, ...rows].join("\n"));
    save(`data:text/csv;charset=utf-8,${text}`, `${given.file}.csv`);
  });
  element("p", root, { className: "note",
    textContent: matchMedia("(pointer: coarse)").matches
      ? "Tap a curve for its values, a name to hide its curve."
      : "Drag over a part to zoom into it, hold Ctrl and roll the wheel to zoom, point at a curve for "
        + "its values, click a name to hide its curve." });
  const paint = () => {
    const style = getComputedStyle(document.documentElement), ink = style.getPropertyValue("--ink");
    for (const s of Object.values(chart.options.scales)) {
      s.grid = { color: style.getPropertyValue("--line") };
      s.ticks.color = s.title.color = ink;
    }
    chart.options.plugins.legend.labels.color = ink;
    datasets.forEach(d => {
      const { colour } = d.given;
      d.borderColor = d.backgroundColor = colour.startsWith("--") ? style.getPropertyValue(colour) : colour;
    });
    chart.update();
  };
  paint();
  show(0);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  stage.chart = chart;
  stage.classList.add("live");
}

for (const stage of document.querySelectorAll(".stage")) {
  const found = stage.querySelector(".chart > script");
  try {
    if (found) drawChart(stage, JSON.parse(found.textContent));
  } catch (error) { // the picture is there all the same
    stage.classList.remove("live");
    console.error(error);
  }
}
