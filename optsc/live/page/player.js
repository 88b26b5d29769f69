// Player: shows the moments of a recorded stream, with a scrubber and a strip of modes.

const COLOURS = { hold: "#c0282d", manual: "#1f6feb", carry: "#18794e" };

export class Player {
  constructor(place, moments, show) {
    Object.assign(this, { moments, show, index: 0, playing: true, speed: 1 });
    // Where the scene began again, so did its time; the recording went on.
    let offset = 0;
    moments.forEach((moment, k) => {
      const before = k ? moments[k - 1] : moment;
      if (moment.time < before.time) offset = before.at;
      moment.at = offset + moment.time;
    });
    this.begin = moments[0].at;
    this.end = moments.at(-1).at;
    this.time = this.begin;
    place.hidden = false;
    place.innerHTML = `<div class="row"><button id="play">Pause</button>
      <input type="range" id="scrub" min="${this.begin}" max="${this.end}" step="0.01" aria-label="time">
      <output id="at"></output><select id="speed" aria-label="speed" style="width:auto">
      <option>0.25</option><option>0.5</option><option selected>1</option><option>2</option><option>4</option></select></div>
      <canvas width="1000" height="12" id="strip"></canvas>`;
    this.scrub = place.querySelector("#scrub");
    this.button = place.querySelector("#play");
    this.at = place.querySelector("#at");
    this.scrub.oninput = () => this.seek(this.scrub.valueAsNumber);
    this.button.onclick = () => this.play(!this.playing);
    place.querySelector("#speed").onchange = (event) => (this.speed = Number(event.target.value));
    this.strip(place.querySelector("#strip"));
  }

  strip(canvas) {
    const pen = canvas.getContext("2d");
    const length = this.end - this.begin || 1;
    for (const [k, moment] of this.moments.entries()) {
      const next = this.moments[k + 1] || moment;
      pen.fillStyle = COLOURS[moment.mode] || "#b35900";
      const x = ((moment.at - this.begin) / length) * 1000;
      pen.fillRect(x, 0, Math.max(1, ((next.at - moment.at) / length) * 1000 + 0.5), 12);
    }
  }

  play(on) {
    this.playing = on;
    if (on && this.time >= this.end) this.time = this.begin;
    this.button.textContent = on ? "Pause" : "Play";
  }

  seek(time) {
    this.time = time;
    this.play(false);
    this.update();
  }

  advance(elapsed) {
    if (!this.playing) return;
    this.time = Math.min(this.end, this.time + elapsed * this.speed);
    if (this.time >= this.end) this.play(false);
    this.update();
  }

  update() {
    let [low, high] = [0, this.moments.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.moments[middle].at <= this.time) low = middle;
      else high = middle - 1;
    }
    this.scrub.value = this.time;
    this.at.textContent = `${(this.time - this.begin).toFixed(1)} s`;
    this.show(this.moments[low]);
  }
}
