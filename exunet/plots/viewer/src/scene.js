// The 3-D scene of one run.
import * as THREE from "three";
import { toCreasedNormals } from "three/examples/jsm/utils/BufferGeometryUtils.js";
import { interval } from "./data.js";
import { step, table } from "./colors.js";

const SLACK_WIDTH = 0.75, TETHER_WIDTH = 2; // of a taut thread
const ALONG = new THREE.Vector3(0, 0, 1);

export class RunScene {
  constructor(run) {
    this.run = run;
    this.scene = new THREE.Scene();
    this.light = new THREE.HemisphereLight(0xffffff, 0x808080, 2.4);
    this.sun = new THREE.DirectionalLight(0xffffff, 1.5);
    this.scene.add(this.light, this.sun, this.sun.target);
    this.at = new Float32Array(3 * run.nodes);
    this.centre = new THREE.Vector3();
    this.breaks = new Float64Array(run.elementCount).fill(Infinity);
    for (const [element, time] of run.broken) this.breaks[element] = time;

    const tube = new THREE.CylinderGeometry(1, 1, 1, 8, 1, true).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    this.threads = instanced(tube, new THREE.MeshLambertMaterial(), run.elementCount, true);
    const pieces = Math.max(0, run.closingPath.length - 1);
    this.lineMaterial = new THREE.MeshLambertMaterial();
    this.line = instanced(tube, this.lineMaterial, pieces, false);
    this.bulletMaterial = new THREE.MeshLambertMaterial();
    const ball = new THREE.SphereGeometry(1, 20, 14);
    this.bullets = instanced(ball, this.bulletMaterial, run.balls.length, false);
    this.reelMaterial = new THREE.MeshLambertMaterial();
    this.reels = instanced(new THREE.TorusGeometry(1, 0.3, 10, 28), this.reelMaterial, run.reels.length, false);
    this.contactMaterial = new THREE.MeshBasicMaterial();
    let most = 1;
    for (let t = 0; t < run.frames; t++) most = Math.max(most, run.contactStarts[t + 1] - run.contactStarts[t]);
    this.contacts = instanced(new THREE.SphereGeometry(1, 10, 8), this.contactMaterial, most, false);
    this.scene.add(this.threads, this.line, this.bullets, this.reels, this.contacts);
    this.forceMaterial = new THREE.MeshBasicMaterial({ depthTest: false, transparent: true });
    this.forceLength = 0; // of an arrow [m/N]
    this.width = new Float32Array(run.elementCount).fill(1);
    for (const [first, last] of run.tethers) this.width.fill(TETHER_WIDTH, first, last);

    this.bodies = run.bodies.map(body => this.addBody(body));
    this.trailMaterial = new THREE.LineDashedMaterial({ dashSize: 0.012 * run.size, gapSize: 0.012 * run.size });
    this.trails = Array.from(run.bullets, node => this.addTrail(node));
    this.look = { theme: null, scale: "root", end: run.tensionMax, relative: false };
    this.ballEntries = Array.from(run.balls, node => 3 * node);
    this.reelEntries = run.reels.map(reel => 3 * reel.node);
    this.scratch = new THREE.Matrix4();
    this.turn = new THREE.Quaternion();
    this.push = new THREE.Vector3();
  }

  addBody(body) {
    const group = new THREE.Group();
    const material = new THREE.MeshLambertMaterial();
    const lines = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.45 });
    if (body.triangles.length) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(body.vertices, 3));
      geometry.setIndex(new THREE.BufferAttribute(body.triangles, 1));
      const mesh = new THREE.Mesh(toCreasedNormals(geometry, 0.35), material);
      material.polygonOffset = true;
      material.polygonOffsetFactor = material.polygonOffsetUnits = 1;
      group.add(mesh, new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), lines));
    } else {
      group.add(new THREE.AxesHelper(0.12 * this.run.size));
    }
    this.scene.add(group);
    return { group, material, lines, arrow: body.force.length ? this.addArrow() : null };
  }

  // Along z from its origin, of length 1; seen through bodies.
  addArrow() {
    const shaft = new THREE.CylinderGeometry(0.025, 0.025, 0.75, 12).translate(0, 0.375, 0), tip = new THREE.ConeGeometry(0.08, 0.25, 16).translate(0, 0.875, 0);
    const arrow = new THREE.Group();
    for (const part of [shaft, tip]) arrow.add(Object.assign(new THREE.Mesh(part.rotateX(Math.PI / 2), this.forceMaterial), { renderOrder: 5 }));
    this.scene.add(arrow);
    return arrow;
  }

  addTrail(node) {
    const { run } = this, way = new Float32Array(3 * run.frames);
    for (let t = 0; t < run.frames; t++) for (let a = 0; a < 3; a++) way[3 * t + a] = run.position[3 * (t * run.nodes + node) + a];
    const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(way, 3));
    const line = new THREE.Line(geometry, this.trailMaterial).computeLineDistances();
    line.frustumCulled = false;
    this.scene.add(line);
    return line;
  }

  setTheme(theme) {
    this.look.theme = theme;
    this.look.table = table(theme);
    this.look.slack = new THREE.Color(theme.slack).toArray();
    this.look.unknown = new THREE.Color(theme.unknown).toArray();
    this.scene.background = new THREE.Color(theme.background);
    this.light.color.set(theme.sky);
    this.light.groundColor.set(theme.ground);
    this.lineMaterial.color.set(theme.line);
    this.bulletMaterial.color.set(theme.bullet);
    this.reelMaterial.color.set(theme.line);
    this.contactMaterial.color.set(theme.contact);
    this.forceMaterial.color.set(theme.force);
    this.trailMaterial.color.set(theme.trail);
    this.bodies.forEach(({ material, lines }, k) => { material.color.set(theme[this.run.bodies[k].role]); lines.color.set(theme.edge); });
  }

  // Show the state at a time, interpolated between stored times; threads have a least radius.
  pose(time, least = 0) {
    const { run, at, look } = this, N = 3 * run.nodes;
    const [low, high, part] = interval(run.time, time);
    this.frame = part < 0.5 ? low : high;
    let x = 0, y = 0, z = 0;
    for (let j = 0, a = low * N, b = high * N; j < N; j++) at[j] = run.position[a + j] * (1 - part) + run.position[b + j] * part;
    for (let j = 0; j < 3 * run.netNodes; j += 3) { x += at[j]; y += at[j + 1]; z += at[j + 2]; }
    this.centre.set(x, y, z).divideScalar(Math.max(1, run.netNodes));

    const matrices = this.threads.instanceMatrix.array, colors = this.threads.instanceColor.array;
    const { table: lut, slack, unknown, scale, end, relative } = look, E = run.elementCount;
    for (let e = 0, a = low * E, b = high * E; e < E; e++) {
      const next = run.time[high] >= this.breaks[e] ? a : b; // up to its break an element holds its last stored tension
      const tension = run.tension[a + e] * (1 - part) + run.tension[next + e] * part;
      const k = step(tension / (relative ? run.strength[e] || 1 : end), scale);
      if (k >= 0 && relative && !(run.strength[e] > 0)) { colors[3 * e] = unknown[0]; colors[3 * e + 1] = unknown[1]; colors[3 * e + 2] = unknown[2]; }
      else if (k < 0) { colors[3 * e] = slack[0]; colors[3 * e + 1] = slack[1]; colors[3 * e + 2] = slack[2]; }
      else { colors[3 * e] = lut[3 * k]; colors[3 * e + 1] = lut[3 * k + 1]; colors[3 * e + 2] = lut[3 * k + 2]; }
      const wide = this.width[e] * Math.max(run.radius[e], least), radius = time >= this.breaks[e] ? 0 : tension > 0 ? wide : SLACK_WIDTH * wide;
      placeTube(matrices, 16 * e, at, 3 * run.elements[2 * e], 3 * run.elements[2 * e + 1], radius);
    }
    this.threads.instanceMatrix.needsUpdate = this.threads.instanceColor.needsUpdate = true;

    const path = run.closingPath, width = Math.max(2 * least, 0.001 * run.size);
    for (let k = 0; k + 1 < path.length; k++) placeTube(this.line.instanceMatrix.array, 16 * k, at, 3 * path[k], 3 * path[k + 1], width);
    this.line.instanceMatrix.needsUpdate = true;
    this.placeBalls(this.bullets, this.ballEntries, Math.min(0.008 * run.size, 8 * least || Infinity));
    this.placeBalls(this.reels, this.reelEntries, Math.min(0.02 * run.size, 16 * least || Infinity));
    this.placeContacts(Math.min(0.006 * run.size, 4 * least || Infinity));

    run.bodies.forEach((body, k) => {
      const { group } = this.bodies[k], p = body.position, q = body.attitude;
      group.position.set(...[0, 1, 2].map(a => p[3 * low + a] * (1 - part) + p[3 * high + a] * part));
      if (q.length) group.quaternion.set(q[4 * low + 1], q[4 * low + 2], q[4 * low + 3], q[4 * low]).slerp(this.turn.set(q[4 * high + 1], q[4 * high + 2], q[4 * high + 3], q[4 * high]), part);
    });
    this.placeForces();
    for (const trail of this.trails) trail.geometry.setDrawRange(0, low + 1);
  }

  placeBalls(mesh, entries, radius) {
    entries.forEach((j, k) => mesh.setMatrixAt(k, this.scratch.makeScale(radius, radius, radius).setPosition(this.at[j], this.at[j + 1], this.at[j + 2])));
    mesh.instanceMatrix.needsUpdate = true;
  }

  // Contacts are known at stored times: those of the nearest are shown.
  placeContacts(radius) {
    const { run, at } = this, first = run.contactStarts[this.frame], last = run.contactStarts[this.frame + 1];
    for (let k = first; k < last; k++) {
      const e = run.contactElements[k], s = run.contactPlaces[k] / 255, i = 3 * run.elements[2 * e], j = 3 * run.elements[2 * e + 1];
      this.scratch.makeScale(radius, radius, radius).setPosition(...[0, 1, 2].map(a => at[i + a] * (1 - s) + at[j + a] * s));
      this.contacts.setMatrixAt(k - first, this.scratch);
    }
    this.contacts.count = last - first;
    this.contacts.instanceMatrix.needsUpdate = true;
  }

  // Forces are known at stored times, as contacts are.
  placeForces() {
    this.run.bodies.forEach(({ force, point }, k) => {
      const { arrow } = this.bodies[k];
      if (!arrow) return;
      this.push.fromArray(force, 3 * this.frame);
      const size = this.push.length();
      arrow.visible = size > 0;
      if (!arrow.visible) return;
      arrow.position.fromArray(point, 3 * this.frame);
      arrow.quaternion.setFromUnitVectors(ALONG, this.push.divideScalar(size));
      arrow.scale.setScalar(size * this.forceLength);
    });
  }

  // What the camera may follow: the net or a body.
  place(name) {
    const k = this.run.bodies.findIndex(body => body.name === name);
    return k < 0 ? this.centre : this.bodies[k].group.position;
  }

  // The box around a state, or around what is followed: the net ("") or a body alone.
  bounds(box, name = null) {
    const { at, run } = this, p = new THREE.Vector3(), k = run.bodies.findIndex(body => body.name === name);
    if (k >= 0) return box.expandByObject(this.bodies[k].group);
    const nodes = name === null ? run.nodes : run.netNodes;
    for (let j = 0; j < 3 * nodes; j += 3) box.expandByPoint(p.set(at[j], at[j + 1], at[j + 2]));
    if (name === null || !nodes) for (const { group } of this.bodies) box.expandByObject(group);
    return box;
  }
}

function instanced(geometry, material, count, colored) {
  const mesh = new THREE.InstancedMesh(geometry, material, Math.max(1, count));
  mesh.count = count;
  mesh.frustumCulled = false;
  mesh.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
  if (colored) {
    mesh.instanceColor = new THREE.InstancedBufferAttribute(new Float32Array(3 * Math.max(1, count)), 3);
    mesh.instanceColor.setUsage(THREE.DynamicDrawUsage);
  }
  return mesh;
}

// The matrix of a tube from node to node: two directions across it, the way along it, the start.
function placeTube(m, o, at, i, j, radius) {
  const x = at[j] - at[i], y = at[j + 1] - at[i + 1], z = at[j + 2] - at[i + 2];
  const length = Math.hypot(x, y, z) || 1e-12, a = x / length, b = y / length, c = z / length;
  let u, v, w;
  if (Math.abs(c) < 0.9) { const h = Math.hypot(a, b) || 1; u = -b / h; v = a / h; w = 0; }
  else { const h = Math.hypot(b, c) || 1; u = 0; v = -c / h; w = b / h; }
  m[o] = u * radius; m[o + 1] = v * radius; m[o + 2] = w * radius; m[o + 3] = 0;
  m[o + 4] = (b * w - c * v) * radius; m[o + 5] = (c * u - a * w) * radius; m[o + 6] = (a * v - b * u) * radius; m[o + 7] = 0;
  m[o + 8] = x; m[o + 9] = y; m[o + 10] = z; m[o + 11] = 0;
  m[o + 12] = at[i]; m[o + 13] = at[i + 1]; m[o + 14] = at[i + 2]; m[o + 15] = 1;
}
