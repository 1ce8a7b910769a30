// Plots over time with a common cursor.
import uPlot from "uplot";
import { digits, valueAt } from "./data.js";

const HEIGHT = 128, DASHES = [[], [6, 4], [2, 3], [9, 3, 2, 3]]; // of two runs, or of the lines of one, for grey

export class Charts {
  constructor(runs, place, seek) {
    this.runs = runs; this.place = place; this.seek = seek; this.charts = [];
  }

  // Groups of series by title; a second run adds its own to a group of the same title.
  groups() {
    const found = new Map();
    this.runs.forEach((run, k) => {
      for (const series of run.series) {
        const key = series.group || series.words;
        if (!found.has(key)) found.set(key, { title: key, unit: series.unit, shown: series.shown, lines: [] });
        found.get(key).shown = Math.min(found.get(key).shown, series.shown);
        found.get(key).lines.push({ ...series, run: k });
      }
    });
    return [...found.values()];
  }

  setTheme(theme, ink, grid) {
    this.theme = theme; this.ink = ink; this.grid = grid;
    for (const chart of [...this.charts]) { this.remove(chart); this.add(chart.group, chart.next); }
  }

  add(group, before = null) {
    const box = document.createElement("figure"), head = document.createElement("figcaption"), close = document.createElement("button");
    head.textContent = titleOf(group);
    close.textContent = "×"; close.className = "close"; close.title = "remove this plot";
    const legend = document.createElement("div");
    legend.className = "values";
    box.append(close, head, legend);
    this.place.insertBefore(box, before);
    const times = [...new Set(group.lines.flatMap(line => Array.from(line.time)))].sort((a, b) => a - b);
    const axis = { stroke: this.ink, grid: { stroke: this.grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const number = (_, values) => values.map(v => String(+v.toPrecision(6)).replace("-", "−"));
    const colors = this.theme.curves, counts = [0, 0];
    const styled = group.lines.map(line => {
      const k = counts[line.run]++;
      return { ...line, color: colors[k % colors.length], dash: DASHES[(this.runs.length > 1 ? line.run : k) % DASHES.length] };
    });
    const plot = new uPlot({
      width: this.width(), height: HEIGHT, legend: { show: false }, padding: [6, 16, 0, 0],
      cursor: { drag: { x: false, y: false }, points: { show: false }, x: false, y: false },
      hooks: { draw: [() => this.now === undefined || this.show(this.now, this.drawn)] },
      scales: { x: { time: false, range: () => this.range } },
      axes: [{ ...axis, size: 24, values: number }, { ...axis, size: 52, values: number }],
      series: [{}, ...styled.map(line => ({ stroke: line.color, width: 1.6, dash: line.dash, spanGaps: false }))],
    }, [times, ...styled.map(line => (times.length === line.time.length ? line.values : times.map(t => within(line, t))))], box);
    const cursor = document.createElement("i");
    cursor.className = "cursor";
    plot.over.append(cursor);
    const texts = styled.map(line => {
      const item = document.createElement("span"), key = document.createElement("b"), text = document.createElement("output");
      key.style.borderTop = `3px ${line.dash.length ? "dashed" : "solid"} ${line.color}`;
      const name = this.runs.length > 1 ? `${"AB"[line.run]} ` : "";
      item.append(key, `${name}${styled.length > 1 && line.label ? line.label : ""} `, text);
      legend.append(item);
      return text;
    });
    const chart = { group, box, plot, cursor, texts, lines: styled, get next() { return box.nextSibling; } };
    const follow = event => this.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
    plot.over.addEventListener("pointerdown", event => {
      follow(event);
      addEventListener("pointermove", follow);
      addEventListener("pointerup", () => removeEventListener("pointermove", follow), { once: true });
    });
    close.onclick = () => this.remove(chart);
    this.charts.push(chart);
    if (this.now !== undefined) this.show(this.now, this.drawn);
    return chart;
  }

  remove(chart) {
    chart.next; // read before the box leaves the page
    this.charts = this.charts.filter(other => other !== chart);
    chart.plot.destroy();
    chart.box.remove();
  }

  width() { return Math.max(200, this.place.clientWidth); }

  resize() { for (const { plot } of this.charts) plot.setSize({ width: this.width(), height: HEIGHT }); }

  // The cursor at a time, and the values of the stored state that each run draws.
  show(time, drawn) {
    Object.assign(this, { now: time, drawn });
    for (const { plot, cursor, texts, lines } of this.charts) {
      cursor.style.transform = `translateX(${plot.valToPos(time, "x")}px)`;
      lines.forEach((line, k) => {
        const value = within(line, drawn[line.run]), text = value === null ? "–" : digits(value);
        if (texts[k].textContent !== text) texts[k].textContent = text;
      });
    }
  }
}

export const titleOf = ({ title, unit }) => (unit ? `${title} [${unit.replace(/\b(m|s)(\d)/g, (_, base, power) => base + "⁰¹²³"[power])}]` : title);

function within({ time: times, values }, time) {
  return time < times[0] || time > times[times.length - 1] ? null : valueAt(times, values, time);
}
