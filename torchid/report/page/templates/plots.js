// Figures over time: zoom, hover, choose the joint and the run. The drawing is replaced once plotly
// is unpacked and its section is open; without it the drawing stays.
const unpacked = (async () => {
  const text = atob(document.getElementById("plotly").textContent);
  const bytes = Uint8Array.from(text, (c) => c.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(plain).text();
  document.head.append(script);
})();

const numbers = ([most, coded]) => {
  const bytes = Uint8Array.from(atob(coded), (c) => c.charCodeAt(0));
  return Array.from(new Int16Array(bytes.buffer), (x) => (x === -32768 ? null : (x / 32767) * most));
};

function plotted(figure, data) {
  const drawing = figure.querySelector(".drawing");
  const pane = document.createElement("div"), bar = document.createElement("div");
  pane.className = "plot";
  bar.className = "choose";
  const choice = (label, names, first) => {
    const select = document.createElement("select"), holder = document.createElement("label");
    names.forEach((name, k) => select.add(new Option(name, k)));
    select.value = first;
    holder.append(label + " ", select);
    if (names.length > 1) bar.append(holder);
    select.addEventListener("change", draw);
    return select;
  };
  const joint = choice("joint", data.joints, data.joint);
  const run = choice("run", data.runs.map((one) => one.name), data.run);
  const whole = document.createElement("button");
  whole.type = "button";
  whole.textContent = "whole run";
  whole.addEventListener("click", () => Plotly.relayout(pane, {"xaxis.autorange": true}));
  const ends = (one) => one.from + (numbers(one.curves.arm[0]).length - 1) * one.step;
  const cut = data.runs.some((one) => one.windows.some(([a, b]) => b - a < 0.95 * (ends(one) - one.from)));
  if (cut) bar.append(whole);
  drawing.replaceWith(bar, pane);

  function draw() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue("--" + name).trim();
    const j = +joint.value, one = data.runs[run.value], scale = data.scales[j];
    const values = {};
    for (const [name, joints] of Object.entries(one.curves)) values[name] = numbers(joints[j]);
    const x = values.arm.map((_, k) => one.from + k * one.step);
    const curves = [["command", "command", "grey", 1.4], ["arm", "arm, measured", "ink", 2.6],
      ["before", data.models[0], "before", 1.6], ["after", data.models[1], "after", 1.6]];
    const traces = [];
    for (const [key, name, shade, width] of curves) {
      if (!values[key]) continue;
      const line = {color: colour(shade), width, dash: key === "after" ? "6px,2px" : "solid"};
      traces.push({x, y: values[key], name, line, mode: "lines", legendgroup: key,
        hovertemplate: "%{y:.4g} " + data.units[j]});
      if (key === "arm" || key === "command") continue;
      const off = values[key].map((v, k) => (v === null || values.arm[k] === null ? null : scale * (values.arm[k] - v)));
      traces.push({x, y: off, name: "arm \u2212 " + name, line: {...line, dash: "solid", width: 1.4}, mode: "lines",
        yaxis: "y2", legendgroup: key, showlegend: false, hovertemplate: "%{y:.3g} " + data.errors[j]});
    }
    const box = {type: "rect", line: {width: 0}, layer: "below"};
    const shapes = (one.aside[j] || []).map(([x0, x1]) => ({...box, x0, x1, yref: "paper", y0: 0, y1: 1, fillcolor: colour("grey"), opacity: 0.16}));
    if (data.noise) shapes.push({...box, xref: "paper", x0: 0, x1: 1, yref: "y2", y0: -scale * data.noise[j], y1: scale * data.noise[j], fillcolor: colour("ink"), opacity: 0.14});
    const axis = {gridcolor: colour("grid"), linecolor: colour("rule"), zeroline: false, automargin: true, ticks: ""};
    const narrow = figure.clientWidth < 600;
    Plotly.react(pane, traces, {
      height: narrow ? 420 : 480, margin: {l: 56, r: 8, t: 8, b: 40}, shapes,
      paper_bgcolor: "transparent", plot_bgcolor: "transparent",
      font: {family: style.getPropertyValue("--sans"), size: 13, color: colour("text")},
      modebar: {bgcolor: "transparent", color: colour("muted"), activecolor: colour("accent")},
      hovermode: "x unified", hoverlabel: {bgcolor: colour("raised"), bordercolor: colour("rule"), font: {color: colour("text")}},
      legend: {orientation: "h", y: 1.02, yanchor: "bottom", x: 0}, hoversubplots: "axis",
      xaxis: {...axis, title: {text: "time [s]"}, range: [...one.windows[j]], anchor: data.models.length ? "y2" : "y", hoverformat: ".2f"},
      yaxis: {...axis, title: {text: `${data.quantity} [${data.units[j]}]`}, domain: [data.models.length ? 0.42 : 0, 1]},
      yaxis2: {...axis, title: {text: `arm \u2212 model [${data.errors[j]}]`}, domain: [0, 0.36], zeroline: true, zerolinecolor: colour("grey")},
    }, {responsive: true, displaylogo: false, displayModeBar: !narrow, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"]});
  }
  draw();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
}

for (const script of document.querySelectorAll('figure script[type="application/json"]')) {
  const figure = script.closest("figure"), section = script.closest("details");
  const show = () => {
    if (!section.open || figure.dataset.plotted) return;
    figure.dataset.plotted = "yes";
    unpacked.then(() => plotted(figure, JSON.parse(script.textContent)));
  };
  section.addEventListener("toggle", show);
  show();
}
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => (one.open = true)));
