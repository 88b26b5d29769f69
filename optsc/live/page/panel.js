// Banner, buttons, sliders and hints.

export const ACTIONS = [
  { name: "TRIGGER", text: "Grasp", key: "Space", shown: "space", primary: true },
  { name: "CANCEL", text: "Take over", key: "Escape", shown: "esc" },
  { name: "NEXT", text: "Next best", key: "KeyN", shown: "N" },
  { name: "CONFIRM", text: "Confirm", key: "Enter", shown: "enter" },
  { name: "VETO", text: "Never this one", key: "KeyV", shown: "V" },
  { name: "RELEASE", text: "Release", key: "KeyR", shown: "R" },
  { name: "PLACE", text: "Place", key: "KeyP", shown: "P" },
];

const SLIDERS = [
  { name: "keep_orientation", text: "nearest turn", low: 1, high: 100, step: 1, rule: "cascade", into: "ranking" },
  { name: "keep_position", text: "then nearest", low: 1, high: 30, step: 1, rule: "cascade", into: "ranking" },
  { name: "orientation", text: "turn", low: 0, high: 5, step: 0.05, rule: "weighted sum", into: "ranking" },
  { name: "position", text: "distance", low: 0, high: 10, step: 0.1, rule: "weighted sum", into: "ranking" },
  { name: "manipulability", text: "manipulability", low: 0, high: 5, step: 0.05, rule: "weighted sum", into: "ranking" },
  { name: "travel", text: "joint travel", low: 0, high: 2, step: 0.02, rule: "weighted sum", into: "ranking" },
  { name: "scale", text: "scale", low: 0.1, high: 3, step: 0.05, into: "mapping" },
  { name: "cutoff", text: "smoothing", low: 0, high: 10, step: 0.25, into: "mapping", unit: " Hz", zero: "off" },
];

const WORDS = {
  hold: ["Holding still", "stopped"],
  manual: ["You lead", "manual"],
  approach: ["Robot goes to the {object}", "automatic"],
  adjust: ["Waiting at the {object}", "automatic"],
  advance: ["Robot reaches for the {object}", "automatic"],
  close: ["Jaws close", "automatic"],
  lift: ["Robot lifts the {object}", "automatic"],
  carry: ["The {object} is lifted", "done"],
  place: ["Robot puts the {object} down", "automatic"],
  release: ["Jaws open", "automatic"],
  retreat: ["Robot moves back", "automatic"],
};

const $ = (id) => document.getElementById(id);

export class Panel {
  constructor(send, press, again) {
    this.send = send;
    this.press = press;
    this.again = again;
    this.values = {};
    this.reason = ["", 0];
  }

  build(scene) {
    $("scene").textContent = `${scene.robot}, ${scene.follower}, scene ${scene.seed}`;
    this.buildActions(scene);
    this.buildSliders(scene);
  }

  buildActions(scene) {
    $("actions").replaceChildren();
    this.buttons = {};
    for (const action of ACTIONS.filter((entry) => scene.buttons.includes(entry.name))) {
      const button = document.createElement("button");
      button.innerHTML = `<span>${action.text}</span><kbd>${action.shown}</kbd>`;
      button.dataset.action = action.name;
      button.classList.toggle("primary", Boolean(action.primary));
      button.onclick = () => this.press(action.name);
      $("actions").append(button);
      this.buttons[action.name] = button;
    }
    const again = document.createElement("button");
    again.textContent = "Begin again";
    again.dataset.action = "AGAIN";
    again.onclick = () => this.again();
    $("actions").append(again);
    this.buttons.AGAIN = again;
  }

  buildSliders(scene) {
    const choice = document.createElement("select");
    choice.id = "rule";
    choice.setAttribute("aria-label", "how grasps are ranked");
    for (const rule of scene.rules) choice.append(new Option(rule === "cascade" ? "cascade (the paper's)" : rule, rule));
    choice.onchange = () => this.send({ rule: choice.value });
    $("ranking").replaceChildren(choice);
    $("mapping").replaceChildren();
    this.sliders = SLIDERS.map((slider) => {
      const row = document.createElement("label");
      row.className = "slider";
      row.innerHTML = `<span>${slider.text}</span><input type="range" id="set-${slider.name}" min="${slider.low}"
        max="${slider.high}" step="${slider.step}"><output></output>`;
      const input = row.querySelector("input");
      input.oninput = () => {
        row.querySelector("output").textContent = this.words(slider, input.valueAsNumber);
        this.send({ [slider.name]: input.valueAsNumber });
      };
      $(slider.into).append(row);
      return { ...slider, row, input };
    });
    const legend = document.createElement("div");
    legend.className = "legend";
    legend.innerHTML = `best <i style="background:linear-gradient(90deg,#0b7a75,#e3b23c,#d1495b)"></i> worst`;
    $("ranking").append(legend);
    this.settings(scene.settings);
  }

  words(slider, value) {
    if (value === 0 && slider.zero) return slider.zero;
    return `${slider.step < 1 ? value.toFixed(2) : value}${slider.unit || ""}`;
  }

  // What the server says holds; a slider that is just being moved is left where the finger is.
  settings(values) {
    this.values = values;
    $("rule").value = values.rule;
    for (const slider of this.sliders) {
      slider.row.hidden = Boolean(slider.rule) && slider.rule !== values.rule;
      if (document.activeElement !== slider.input || !slider.input.matches(":active")) {
        slider.input.value = values[slider.name];
        slider.row.querySelector("output").textContent = this.words(slider, values[slider.name]);
      }
    }
  }

  role(role, claim) {
    const place = $("role");
    place.replaceChildren();
    this.drives = role.drives;
    if (role.drives) {
      place.textContent = role.pages > 1 ? `You drive; ${role.pages - 1} watching` : "You drive";
    } else {
      const words = document.createElement("span");
      words.className = "watching";
      words.textContent = role.free ? "Nobody drives" : "You watch: another page drives";
      place.append(words);
      if (role.free) {
        const button = document.createElement("button");
        button.id = "claim";
        button.textContent = "Drive from here";
        button.onclick = claim;
        place.append(button);
      }
    }
  }

  show(moment, hand) {
    const object = moment.name("held") || moment.name("target_object") || moment.name("intended") || "object";
    const [words, kind] = WORDS[moment.mode] || [moment.mode, "automatic"];
    let title = words.replace("{object}", object);
    let colour = kind;
    let reason = this.lasting(moment);
    if (moment.mode === "manual" && !hand.source && hand.drives) title = "Yours to lead";
    if (moment.silent) {
      [title, colour, reason] = ["The control process is silent", "stopped", `for ${moment.silent.toFixed(1)} s; the arm holds`];
    }
    this.banner(title, reason, colour, moment.mode === "hold" || Boolean(moment.silent));
    this.enable(moment);
    this.showTerms(moment);
    $("coach").textContent = this.drives ? coach(moment, hand, object) : "";
  }

  // A reason that lasted for one tick has to stay long enough to be read.
  lasting(moment) {
    const now = performance.now();
    const calm = moment.status === "following" || moment.status === "at rest" || moment.status === "coming to rest";
    const held = moment.status === "held back by a joint limit" || moment.status === "held back by something near";
    const text = (held && moment.reason ? `slowed by ${moment.reason}` : moment.reason) || (calm || moment.status === "no new target for too long" ? "" : moment.status);
    if (text) this.reason = [text, now + 2500];
    return now < this.reason[1] ? this.reason[0] : "";
  }

  banner(title, reason, kind, held) {
    $("mode").textContent = title;
    $("reason").textContent = reason;
    $("banner").dataset.kind = kind;
    $("banner").dataset.held = held;
  }

  enable(moment) {
    const { mode } = moment;
    const can = {
      TRIGGER: true,
      CANCEL: moment.automatic,
      NEXT: mode === "approach" || mode === "adjust",
      CONFIRM: mode === "adjust" || mode === "approach",
      VETO: mode === "manual" || mode === "approach" || mode === "adjust",
      RELEASE: moment.one("held") !== -1,
      PLACE: moment.one("held") !== -1 && mode !== "place",
      AGAIN: true,
    };
    for (const [name, button] of Object.entries(this.buttons)) {
      button.disabled = !this.drives || can[name] === false;
    }
    const full = moment.one("held") !== -1;
    const text = moment.automatic ? "Take over" : mode === "hold" ? "Begin" : full ? "Put down" : "Grasp";
    this.buttons.TRIGGER.firstElementChild.textContent = text;
    this.buttons.CANCEL.firstElementChild.textContent = "Stop";
  }

  showTerms(moment) {
    const terms = moment.of("terms");
    const name = moment.name("intended");
    if (!name || Number.isNaN(terms[0])) {
      $("terms").replaceChildren();
      return;
    }
    const lines = moment.scene.terms.map(([term, unit], k) => {
      const number = `${terms[k].toFixed(3)}${unit === "-" ? "" : ` ${unit}`}`;
      return `<dt>${term}</dt><dd>${number}</dd>`;
    });
    $("terms").innerHTML = `<dt class="head">selected of the ${name}</dt>${lines.join("")}`;
  }
}

function coach(moment, hand, object) {
  if (moment.mode === "hold") return "Take the orange ball and drag it, or hold W A S D";
  if (moment.mode === "manual") {
    if (!hand.everMoved) return "Drag the ball towards an object: a ghost shows how the robot would grasp it";
    if (moment.one("held") !== -1) return "Press space or P: the robot puts it down here; R lets it go";
    return `Press space: the robot grasps the ${object}`;
  }
  if (moment.mode === "carry") return "Take the ball to carry it elsewhere; P puts it down";
  if (moment.mode === "place" || moment.mode === "release" || moment.mode === "retreat") {
    return "Take the ball at any moment to lead yourself";
  }
  return "Take the ball at any moment to lead yourself; N takes another grasp";
}
