// View: the arm, what is on its table, candidates, ghosts and the path, drawn by three.js. World axes: z is up.

import * as THREE from "three";

const GOOD = new THREE.Color("#0b7a75");
const MIDDLE = new THREE.Color("#e3b23c");
const POOR = new THREE.Color("#d1495b");
const OBJECTS = ["#7aa6c2", "#c98b70", "#9bb07a", "#b08bb5", "#d1b36a", "#7d8fa9"];
const LINK = new THREE.Color("#e9edf1");
const DOTS = 26;

export function place(object, numbers, at = 0) {
  object.position.set(numbers[at], numbers[at + 1], numbers[at + 2]);
  object.quaternion.set(numbers[at + 4], numbers[at + 5], numbers[at + 6], numbers[at + 3]);
}

function geometry(numbers, part, creased) {
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(numbers.slice(...part.vertices), 3));
  made.setIndex(new THREE.BufferAttribute(Uint32Array.from(numbers.subarray(...part.faces)), 1));
  if (creased) return THREE.toCreasedNormals(made, 0.6);
  made.computeVertexNormals();
  return made;
}

function label(text) {
  const canvas = document.createElement("canvas");
  canvas.width = 256;
  canvas.height = 64;
  const pen = canvas.getContext("2d");
  pen.font = "600 34px system-ui, 'Liberation Sans', sans-serif";
  pen.textAlign = "center";
  pen.lineWidth = 8;
  pen.strokeStyle = "rgba(255,255,255,.9)";
  pen.strokeText(text, 128, 44);
  pen.fillStyle = "#1d2733";
  pen.fillText(text, 128, 44);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false }));
  sprite.scale.set(0.16, 0.04, 1);
  sprite.renderOrder = 3;
  return sprite;
}

export class View {
  constructor(canvas, light) {
    this.light = light;
    this.period = light ? 80 : 0; // from one drawing to the next at least [ms]: a processor that draws has other work
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !light });
    this.renderer.setPixelRatio(light ? 1 : Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = !light;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.xr.enabled = true;
    this.world = new THREE.Scene();
    this.world.background = new THREE.Color("#eef2f5");
    this.camera = new THREE.PerspectiveCamera(38, 1, 0.02, 20);
    this.camera.up.set(0, 0, 1);
    this.rig = new THREE.Group(); // where a person with a headset stands
    this.rig.add(this.camera);
    this.world.add(this.rig);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.maxPolarAngle = 0.52 * Math.PI;
    this.controls.minDistance = 0.3;
    this.controls.maxDistance = 4;
    this.showCandidates = true;
    this.lookFromTheStart();
    this.room();
    this.resize();
    addEventListener("resize", () => this.resize());
  }

  lookFromTheStart() {
    this.camera.position.set(1.45, -1.2, 0.95);
    this.controls.target.set(0.33, -0.02, 0.27);
    this.controls.update();
  }

  room() {
    this.world.add(new THREE.HemisphereLight("#ffffff", "#b9c4cf", 2.1));
    const sun = new THREE.DirectionalLight("#ffffff", 1.9);
    sun.position.set(0.9, -1.3, 2.4);
    sun.castShadow = !this.light;
    sun.shadow.mapSize.set(2048, 2048);
    Object.assign(sun.shadow.camera, { left: -1.2, right: 1.2, top: 1.2, bottom: -1.2, near: 0.5, far: 5 });
    sun.shadow.bias = -0.0005;
    sun.shadow.normalBias = 0.01;
    sun.target.position.set(0.4, 0, 0);
    this.world.add(sun, sun.target);
    const table = new THREE.Mesh(
      new THREE.PlaneGeometry(2.2, 2.2),
      new THREE.MeshStandardMaterial({ color: "#dfe5ea", roughness: 0.95 }),
    );
    table.position.set(0.35, 0, -0.002);
    table.receiveShadow = true;
    const grid = new THREE.GridHelper(2.2, 22, "#c3ccd4", "#d1d9e0");
    grid.rotation.x = Math.PI / 2;
    grid.position.set(0.35, 0, -0.0005);
    this.world.add(table, grid);
  }

  resize() {
    const { clientWidth: w, clientHeight: h } = this.renderer.domElement.parentElement;
    if (this.renderer.xr.isPresenting || !w || !h) return;
    this.renderer.setSize(w, h, false);
    this.camera.aspect = w / h;
    this.camera.updateProjectionMatrix();
  }

  // A scene came: everything of the one before goes.
  build(scene, numbers) {
    if (this.content) this.world.remove(this.content);
    this.scene = scene;
    this.content = new THREE.Group();
    this.world.add(this.content);
    this.links = scene.links.map((link) => {
      const colour = link.colour ? new THREE.Color(...link.colour.slice(0, 3)) : LINK;
      const mesh = new THREE.Mesh(
        geometry(numbers, link, !this.light),
        new THREE.MeshStandardMaterial({ color: colour, roughness: 0.55, metalness: 0.05 }),
      );
      mesh.castShadow = mesh.receiveShadow = true;
      this.content.add(mesh);
      return mesh;
    });
    this.objects = scene.objects.map((object, k) => {
      const group = new THREE.Group();
      const mesh = new THREE.Mesh(
        geometry(numbers, object, true),
        new THREE.MeshStandardMaterial({ color: OBJECTS[k % OBJECTS.length], roughness: 0.7 }),
      );
      mesh.castShadow = mesh.receiveShadow = true;
      mesh.geometry.computeBoundingBox();
      const name = label(object.name);
      name.position.z = mesh.geometry.boundingBox.max.z + 0.05;
      group.add(mesh, name);
      this.content.add(group);
      return group;
    });
    this.buildGhosts(numbers);
    this.buildCandidates(numbers);
    const dot = new THREE.SphereGeometry(0.0045, 10, 8);
    this.path = new THREE.InstancedMesh(dot, new THREE.MeshBasicMaterial({ color: "#1f6feb" }), DOTS);
    this.path.frustumCulled = false;
    this.content.add(this.path);
  }

  buildGhosts(numbers) {
    const hand = this.scene.hand;
    const open = numbers.subarray(...hand.open);
    const closed = numbers.subarray(...hand.closed);
    this.ghosts = this.scene.objects.map(() => {
      const ghost = new THREE.Group();
      const material = new THREE.MeshStandardMaterial({
        color: "#1f6feb", transparent: true, opacity: 0.34, depthWrite: false, roughness: 0.8,
      });
      ghost.parts = hand.links.map((link, k) => {
        const part = new THREE.Mesh(this.links[link].geometry, material);
        part.open = open.slice(7 * k, 7 * k + 7);
        part.closed = closed.slice(7 * k, 7 * k + 7);
        place(part, part.open);
        ghost.add(part);
        return part;
      });
      ghost.material = material;
      ghost.visible = false;
      this.content.add(ghost);
      return ghost;
    });
  }

  buildCandidates(numbers) {
    const { object, poses } = this.scene.grasps;
    // The tip points at the grasp, the stick lies along its approach.
    const stick = new THREE.ConeGeometry(0.0028, 0.026, 5);
    stick.rotateX(Math.PI / 2);
    stick.translate(0, 0, -0.045);
    this.candidates = new THREE.InstancedMesh(stick, new THREE.MeshBasicMaterial(), object.length);
    this.candidates.frustumCulled = false;
    this.inObject = [];
    const helper = new THREE.Object3D();
    for (let i = 0; i < object.length; i++) {
      place(helper, numbers.subarray(...poses), 7 * i);
      helper.updateMatrix();
      this.inObject.push(helper.matrix.clone());
      this.candidates.setColorAt(i, GOOD);
    }
    this.content.add(this.candidates);
  }

  show(moment) {
    const links = moment.of("links");
    this.links.forEach((mesh, k) => place(mesh, links, 7 * k));
    const objects = moment.of("objects");
    this.objects.forEach((group, k) => {
      if (!Number.isNaN(objects[7 * k])) place(group, objects, 7 * k);
      group.updateMatrixWorld();
    });
    this.showGhosts(moment);
    this.showRanks(moment);
    this.showPath(moment);
  }

  showGhosts(moment) {
    const shown = moment.of("shown");
    const widths = moment.of("widths");
    const goal = moment.automatic ? moment.one("target_object") : moment.one("intended");
    const path = moment.of("path");
    this.ghosts.forEach((ghost, k) => {
      const ahead = ["approach", "adjust", "advance"].includes(moment.mode) && k === goal;
      const offered = !moment.automatic && moment.one("held") === -1;
      ghost.visible = !Number.isNaN(shown[7 * k]) && (ahead || offered);
      if (!ghost.visible) return;
      if (moment.automatic) place(ghost, path, 7);
      else place(ghost, shown, 7 * k);
      const share = Math.min(1, (widths[k] + 0.006) / this.scene.hand.opening || 0);
      for (const part of ghost.parts) {
        part.position.fromArray(part.closed).lerp(new THREE.Vector3().fromArray(part.open), share);
      }
      ghost.material.color.set(k === goal ? "#1f6feb" : "#8794a1");
      ghost.material.opacity = k === goal ? 0.5 : 0.17;
    });
  }

  showRanks(moment) {
    const ranks = moment.of("ranks");
    const visible = this.showCandidates && !moment.automatic && moment.one("held") === -1;
    this.candidates.visible = visible;
    if (!visible) return;
    const intended = moment.one("intended");
    const matrix = new THREE.Matrix4();
    const colour = new THREE.Color();
    const owner = this.scene.grasps.object;
    const nothing = new THREE.Matrix4().makeScale(0, 0, 0);
    for (let i = 0; i < ranks.length; i++) {
      const rank = ranks[i];
      if (Number.isNaN(rank)) {
        this.candidates.setMatrixAt(i, nothing);
        continue;
      }
      matrix.multiplyMatrices(this.objects[owner[i]].matrixWorld, this.inObject[i]);
      const size = (owner[i] === intended ? 1.25 : 0.8) * (1 - 0.45 * rank);
      matrix.scale(new THREE.Vector3(size, size, size));
      this.candidates.setMatrixAt(i, matrix);
      if (rank < 0.5) colour.lerpColors(GOOD, MIDDLE, 2 * rank);
      else colour.lerpColors(MIDDLE, POOR, 2 * rank - 1);
      this.candidates.setColorAt(i, colour);
    }
    this.candidates.instanceMatrix.needsUpdate = true;
    if (this.candidates.instanceColor) this.candidates.instanceColor.needsUpdate = true;
  }

  showPath(moment) {
    const path = moment.of("path");
    const visible = !Number.isNaN(path[0]) && (moment.mode === "approach" || moment.mode === "adjust" ||
      moment.mode === "advance" || (!moment.automatic && moment.one("held") === -1));
    this.path.visible = visible;
    if (!visible) return;
    const target = moment.of("target");
    const points = [target, path.subarray(0, 7), path.subarray(7, 14)].map((p) => new THREE.Vector3().fromArray(p));
    if (moment.mode === "advance") points.splice(1, 1);
    const lengths = points.slice(1).map((p, k) => p.distanceTo(points[k]));
    const whole = lengths.reduce((a, b) => a + b, 0);
    const matrix = new THREE.Matrix4();
    for (let i = 0; i < DOTS; i++) {
      let left = (whole * (i + 1)) / DOTS;
      let k = 0;
      while (k < lengths.length - 1 && left > lengths[k]) left -= lengths[k++];
      const at = points[k].clone().lerp(points[k + 1], lengths[k] ? Math.min(1, left / lengths[k]) : 1);
      matrix.makeTranslation(at.x, at.y, at.z);
      this.path.setMatrixAt(i, matrix);
    }
    this.path.instanceMatrix.needsUpdate = true;
    this.path.material.color.set(moment.automatic ? "#b35900" : "#1f6feb");
  }

  // Where a point of the world is on the screen [pixels from the corner of the window].
  onScreen(p) {
    const at = new THREE.Vector3(...p).project(this.camera);
    const box = this.renderer.domElement.getBoundingClientRect();
    return { x: box.left + (0.5 + 0.5 * at.x) * box.width, y: box.top + (0.5 - 0.5 * at.y) * box.height };
  }

  draw() {
    this.renderer.render(this.world, this.camera);
  }
}
