// Small plots over the last ten seconds.

const SECONDS = 10;

class Plot {
  constructor(place, title, unit, least, traces) {
    Object.assign(this, { unit, least, traces, points: [] });
    const box = document.createElement("div");
    box.className = "plot";
    box.innerHTML = `<div><span>${title}</span><b></b></div><canvas></canvas>`;
    place.append(box);
    this.value = box.querySelector("b");
    this.canvas = box.querySelector("canvas");
  }

  add(time, values) {
    const last = this.points.at(-1);
    if (last && time < last[0]) this.points = [];
    this.points.push([time, ...values]);
    while (this.points[0][0] < time - SECONDS) this.points.shift();
  }

  draw() {
    const { canvas, points } = this;
    if (!points.length) return;
    const ratio = devicePixelRatio || 1;
    const [w, h] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio];
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const pen = canvas.getContext("2d");
    const end = points.at(-1)[0];
    const most = Math.max(this.least, ...points.map((p) => Math.max(...p.slice(1)))) * 1.1;
    pen.clearRect(0, 0, w, h);
    pen.strokeStyle = "#dde3e9";
    pen.lineWidth = ratio;
    pen.strokeRect(0.5, 0.5, w - 1, h - 1);
    this.traces.forEach(([, colour], k) => {
      pen.beginPath();
      pen.strokeStyle = colour;
      pen.lineWidth = 1.5 * ratio;
      for (const p of points) pen.lineTo(((p[0] - end) / SECONDS + 1) * w, h - (p[k + 1] / most) * (h - 2) - 1);
      pen.stroke();
    });
    const words = this.traces.map(([name], k) => `${name}${points.at(-1)[k + 1].toFixed(2)}`);
    this.value.textContent = `${words.join(" / ")} ${this.unit}`;
  }
}

export class Plots {
  constructor(place) {
    this.error = new Plot(place, "tracking error", "mm", 1, [["", "#1f6feb"]]);
    this.tick = new Plot(place, "tick / lateness", "ms", 2, [["", "#18794e"], ["", "#c0282d"]]);
    this.cost = new Plot(place, "selected: turn / distance", "- / m", 0.3, [["", "#b35900"], ["", "#5c6b7a"]]);
    this.note = document.createElement("div");
    this.note.className = "plot";
    place.append(this.note);
    this.drawn = 0;
  }

  show(moment) {
    const error = moment.of("error");
    this.error.add(moment.time, [1000 * Math.hypot(error[0], error[1], error[2])]);
    this.tick.add(moment.time, [1000 * moment.one("elapsed"), 1000 * moment.one("worst_late")]);
    const terms = moment.of("terms");
    if (!Number.isNaN(terms[0])) this.cost.add(moment.time, [terms[0], terms[1]]);
    const now = performance.now();
    if (now - this.drawn < 100) return;
    this.drawn = now;
    for (const plot of [this.error, this.tick, this.cost]) plot.draw();
    const lost = moment.one("lost");
    this.note.textContent = `${moment.one("late_ticks")} ticks more than 2 ms late` +
      (lost > 0 ? `, ${lost.toFixed(1)} s lost: this machine is too slow` : "");
    this.note.style.color = lost > 0 ? "#c0282d" : "#5c6b7a";
    this.note.style.fontSize = "12px";
  }
}
