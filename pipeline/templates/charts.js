"use strict";
(function () {
  const root = document.documentElement;
  const colour = (name) => getComputedStyle(root).getPropertyValue("--" + name).trim();
  const faded = (name) => "color-mix(in srgb, " + colour(name) + " 22%, transparent)";
  const all = [];

  function shown(value, digits) {
    return value == null ? "–" : value.toFixed(digits);
  }

  function power(value) {
    if (value == null) return "";
    const exponent = Math.round(Math.log10(value));
    if (Math.abs(value / Math.pow(10, exponent) - 1) > 1e-6) return String(value);
    if (Math.abs(exponent) < 3) return String(Number(value.toPrecision(3)));
    const raised = Array.from(String(exponent)).map((sign) => "⁰¹²³⁴⁵⁶⁷⁸⁹"["0123456789".indexOf(sign)] || "⁻").join("");
    return "10" + raised;
  }

  function axis(label, size) {
    return {
      label: label, labelSize: 20, labelFont: "13px system-ui, sans-serif", font: "12px system-ui, sans-serif", size: size,
      stroke: () => colour("ink"), grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("grid"), width: 1, size: 5 },
    };
  }

  function bars(panel) {
    return panel.curves.some((curve) => curve.style === "bars");
  }

  function xAxis(chart, index) {
    const last = index === chart.panels.length - 1;
    const found = axis(last ? chart.x_label : null, last ? 46 : 26);
    if (chart.discrete) found.incrs = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
    return found;
  }

  function yAxis(panel, width) {
    const found = axis(panel.y_label, width < 480 ? 48 : 58);
    if (panel.log_y) found.values = (u, splits) => splits.map(power);
    return found;
  }

  function decades(low, high) {
    return [Math.pow(10, Math.floor(Math.log10(Math.max(low, high * 1e-6)))), Math.pow(10, Math.ceil(Math.log10(high)))];
  }

  function series(curve) {
    if (curve.hidden || curve.style === "none") {
      const stroke = curve.hidden ? "transparent" : () => colour("c-" + curve.role);
      return { label: curve.name, stroke: stroke, width: 0, points: { show: false }, value: () => "" };
    }
    const points = curve.style === "points", marked = points || curve.style === "marked";
    return {
      label: curve.name, stroke: () => colour("c-" + curve.role), width: points ? 0 : 1.6, spanGaps: false,
      dash: { dash: [7, 4], dots: [2, 4] }[curve.style],
      paths: curve.style === "bars" ? uPlot.paths.bars({ size: [0.8, 60] }) : points ? () => null : undefined,
      fill: curve.style === "bars" ? () => faded("c-" + curve.role) : undefined,
      points: { show: marked, size: 7, fill: () => colour("c-" + curve.role) },
      value: (u, v) => curve.log ? (v == null ? "–" : v.toPrecision(3)) : shown(v, curve.digits),
    };
  }

  function levels(panel) {
    return (u) => {
      const ctx = u.ctx;
      ctx.save();
      ctx.strokeStyle = colour("muted"); ctx.fillStyle = colour("muted");
      ctx.font = 11 * devicePixelRatio + "px system-ui, sans-serif";
      ctx.textAlign = "right";
      ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
      panel.levels.forEach(([value, label]) => {
        const y = Math.round(u.valToPos(value, "y", true));
        if (y < u.bbox.top || y > u.bbox.top + u.bbox.height) return;
        ctx.beginPath(); ctx.moveTo(u.bbox.left, y); ctx.lineTo(u.bbox.left + u.bbox.width, y); ctx.stroke();
        ctx.fillText(label, u.bbox.left + u.bbox.width - 4, y - 4);
      });
      ctx.restore();
    };
  }

  function options(chart, index, width, group) {
    const panel = chart.panels[index];
    return {
      width: width, height: index === chart.panels.length - 1 ? 250 : 230, pxAlign: true,
      cursor: { sync: { key: chart.key, scales: ["x", null] }, drag: { x: true, y: false, setScale: true }, focus: { prox: 24 } },
      legend: { live: true },
      scales: {
        x: { time: false, distr: chart.log_x ? 3 : 1, range: (u, low, high) => [low, high] },
        y: { distr: panel.log_y ? 3 : 1, range: (u, low, high) => panel.log_y ? decades(low, high) : margins(low, high, panel) },
      },
      axes: [xAxis(chart, index), yAxis(panel, width)],
      series: [{ label: chart.x_short, value: (u, v) => shown(v, chart.x_digits) }].concat(panel.curves.map(series)),
      bands: panel.bands.map(([high, low, role]) => ({ series: [high + 1, low + 1], fill: () => faded("c-" + role) })),
      hooks: {
        draw: [levels(panel)],
        setScale: [(u, key) => { if (key === "x") group.follow(u); }],
      },
    };
  }

  function margins(low, high, panel) {
    if (bars(panel)) { low = Math.min(low, 0); high = Math.max(high, 0); }
    panel.levels.forEach(([value]) => { low = Math.min(low, value); high = Math.max(high, value); });
    const room = (high - low || Math.abs(high) || 1) * 0.06;
    return [low - room, high + room];
  }

  function Group(figure, chart) {
    this.chart = chart; this.figure = figure; this.plots = []; this.busy = false;
    this.holder = figure.querySelector(".chart");
    chart.panels.forEach((panel, index) => {
      const place = document.createElement("div");
      this.holder.appendChild(place);
      const plot = new uPlot(options(chart, index, this.width(), this), panel.data, place);
      place.querySelectorAll(".u-series").forEach((row, at) => {
        if (at > 0 && panel.curves[at - 1].hidden) row.style.display = "none";
      });
      plot.over.addEventListener("dblclick", () => this.act("all"));
      this.plots.push(plot);
    });
    const xs = this.plots.map((plot) => plot.data[0]);
    const pad = chart.discrete ? 0.6 : 0;
    this.full = [Math.min(...xs.map((x) => x[0])) - pad, Math.max(...xs.map((x) => x[x.length - 1])) + pad];
    figure.querySelectorAll(".tools button").forEach((button) =>
      button.addEventListener("click", () => this.act(button.dataset.act)));
    this.holder.addEventListener("keydown", (event) => this.key(event));
    this.show(this.full[0], this.full[1]);
  }

  Group.prototype.width = function () { return Math.max(240, this.holder.clientWidth - 8); };

  Group.prototype.show = function (low, high) {
    this.plots.forEach((plot) => plot.setScale("x", { min: low, max: high }));
    this.figure.dataset.low = low; this.figure.dataset.high = high;
  };

  Group.prototype.follow = function (from) {
    if (this.busy || this.plots.length === 0 || !this.full) return;
    this.busy = true;
    const scale = from.scales.x;
    this.plots.forEach((plot) => {
      if (plot !== from && (plot.scales.x.min !== scale.min || plot.scales.x.max !== scale.max)) {
        plot.setScale("x", { min: scale.min, max: scale.max });
      }
    });
    this.figure.dataset.low = scale.min; this.figure.dataset.high = scale.max;
    this.busy = false;
  };

  Group.prototype.act = function (what) {
    const scale = this.plots[0].scales.x;
    const log = this.chart.log_x;
    const to = log ? Math.log : (v) => v, from = log ? Math.exp : (v) => v;
    const low = to(scale.min), high = to(scale.max), first = to(this.full[0]), last = to(this.full[1]);
    const part = { in: [0.25, -0.25], out: [-0.5, 0.5], left: [-0.25, -0.25], right: [0.25, 0.25] }[what];
    if (!part) { this.show(this.full[0], this.full[1]); return; }
    const width = high - low;
    const shift = what === "left" ? Math.max(part[0], (first - low) / width) : what === "right" ? Math.min(part[0], (last - high) / width) : null;
    const next = shift === null ? [low + part[0] * width, high + part[1] * width] : [low + shift * width, high + shift * width];
    this.show(from(Math.max(first, next[0])), from(Math.min(last, next[1])));
  };

  Group.prototype.key = function (event) {
    const act = { "+": "in", "=": "in", "-": "out", "0": "all", Home: "all" }[event.key];
    if (act) { this.act(act); event.preventDefault(); return; }
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const plot = this.plots[0], x = plot.data[0], scale = plot.scales.x;
    const inside = x.map((v, i) => i).filter((i) => x[i] >= scale.min && x[i] <= scale.max);
    if (inside.length === 0) return;
    const stride = Math.max(1, Math.round(inside.length / 60));
    const at = plot.cursor.idx == null || plot.cursor.left < 0 ? inside[0] : plot.cursor.idx + step * stride;
    const next = Math.min(inside[inside.length - 1], Math.max(inside[0], at));
    this.plots.forEach((each) => each.setCursor({ left: each.valToPos(x[next], "x"), top: each.over.clientHeight / 2 }));
    const read = plot.root.querySelectorAll(".u-series");
    this.figure.querySelector(".read").textContent = Array.from(read)
      .filter((row) => row.style.display !== "none").map((row) => row.textContent).join(", ");
  };

  function start() {
    document.querySelectorAll("figure[data-chart]").forEach((figure) => {
      const chart = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
      figure.classList.add("drawn");
      all.push(new Group(figure, chart));
    });
    let waiting = 0;
    addEventListener("resize", () => {
      clearTimeout(waiting);
      waiting = setTimeout(() => all.forEach((group) =>
        group.plots.forEach((plot) => plot.setSize({ width: group.width(), height: plot.height }))), 120);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
      all.forEach((group) => group.plots.forEach((plot) => plot.redraw())));
    root.dataset.charts = String(all.length);
  }

  start();
})();
