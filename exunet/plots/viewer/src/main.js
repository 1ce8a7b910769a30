// Page of one result, or of two beside each other: view, time bar, plots.
import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import uPlotStyle from "uplot/dist/uPlot.min.css";
import style from "./style.css";
import { Charts, titleOf } from "./charts.js";
import { SCALES, THEMES } from "./colors.js";
import { digits, interval, load, round, valueAt } from "./data.js";
import { RunScene } from "./scene.js";

const SPEEDS = [0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];
const HIDDEN = 99; // place of a plot that is not shown at first
const OUTCOMES = { "CAPTURED": ["✓", "good"], "NOT CAPTURED": ["✗", "bad"], "UNDETERMINED": ["?", "open"], "STOPPED": ["■", "bad"] }; // sign, colour
const NARROW = matchMedia("(max-width: 900px)");
const ARROW = 0.3; // length of the largest force, of the size of the net
const KEYS = [
  ["Space", "play, pause"], ["← →", "stored state before, after (Shift: ten)"], ["Home End", "start, end"], ["+ −", "faster, slower"],
  ["0", "fit all"], ["1 2 3", "front, side, top"], ["F", "follow the next"], ["M", "measure: click two points"], ["L", "names"], ["P", "save picture"], ["T", "light, dark"],
];

const hex = color => `#${color.toString(16).padStart(6, "0")}`;

// What the legend explains beside the colours, drawn on 24 x 12 pixels.
const stroke = (width, dash = []) => pen => { pen.lineWidth = width; pen.setLineDash(dash); pen.beginPath(); pen.moveTo(1, 6); pen.lineTo(23, 6); pen.stroke(); };
const disk = radius => pen => { pen.beginPath(); pen.arc(12, 6, radius, 0, 7); pen.fill(); };
const SIGNS = [
  { words: "slack thread", color: "slack", draw: stroke(1.5), of: run => run.elementCount },
  { words: "taut thread without a strength", color: "unknown", draw: stroke(2), of: (run, relative) => relative && run.strength.some(value => !(value > 0)) },
  { words: "tether (wide)", color: "slack", draw: stroke(5), of: run => run.tethers.length },
  { words: "closing line", color: "line", draw: stroke(3), of: run => run.closingPath.length },
  { words: "reel", color: "line", draw: pen => { pen.lineWidth = 2; pen.beginPath(); pen.arc(12, 6, 4, 0, 7); pen.stroke(); }, of: run => run.reels.length },
  { words: "bullet", color: "bullet", draw: disk(4), of: run => run.bullets.length },
  { words: "node without threads", color: "bullet", draw: disk(4), of: run => run.balls.length > run.bullets.length },
  { words: "path of a bullet", color: "trail", draw: stroke(1, [3, 3]), of: run => run.bullets.length },
  { words: "contact", color: "contact", draw: disk(2), of: run => run.contactElements.length },
  {
    words: newton => `contact force on a body, ${digits(newton, 1)} N per m`, color: "force", of: run => run.bodies.some(({ force }) => force.some(value => value)),
    draw: pen => { stroke(2)(pen); pen.beginPath(); pen.moveTo(23, 6); pen.lineTo(15, 2); pen.lineTo(15, 10); pen.fill(); },
  },
];

const make = (tag, properties = {}, ...children) => { const element = Object.assign(document.createElement(tag), properties); element.append(...children); return element; };
const option = (value, text) => make("option", { value, textContent: text });

async function main() {
  const { runs, answer, table, case: text, provenance, heading } = await load();
  document.head.append(make("style", { textContent: uPlotStyle + style }));
  document.title = heading;

  // The page
  const view = make("div", { id: "view" }), labels = make("div", { id: "labels" }), status = make("div", { id: "status" });
  const scaleChoice = make("select", { id: "scale", title: "scale of the colours" }, ...Object.entries(SCALES).map(([key, { label }]) => option(key, label)));
  const endChoice = make("select", { id: "end", title: "upper end of the colours" }, option("largest", "to the largest shown"), option("now", "to the largest now"));
  if (runs.some(run => run.strength.some(value => value > 0))) { endChoice.prepend(option("strength", "to the strength")); endChoice.value = "strength"; }
  const legendTitle = make("div"), legendBar = make("div", { id: "legend" }), legendTicks = make("div", { className: "ticks" });
  const signs = make("div", { className: "signs" });
  const legend = make("div", { className: "key" }, legendTitle, legendBar, legendTicks, signs, make("div", {}, scaleChoice, endChoice));
  const outcomes = answer.filter(([name]) => name in OUTCOMES).map(([name]) => make("strong", { className: `outcome ${OUTCOMES[name][1]}`, textContent: `${OUTCOMES[name][0]} ${name}` }));
  const events = make("div", { id: "events" }), plots = make("div", { id: "plots" }), more = make("select", { id: "more", title: "add a plot" });
  const rows = (list, id) => make("table", { id, className: "rows" }, ...list.map(([name, ...values]) => make("tr", {}, make("th", { textContent: name }), make("td", {}, ...values.flatMap(value => [make("span", { textContent: value }), " "])))));
  const section = (title, content) => make("details", { className: "section" }, make("summary", { textContent: title }), content);
  const aside = make("aside", {}, ...(answer.length ? [rows(answer, "answer")] : []), events, plots, more, ...(table.length ? [rows(table, "table")] : []));
  if (text) aside.append(section("Case", make("pre", { textContent: text })), section("Provenance", rows(provenance, "provenance")));
  const play = make("button", { id: "play", textContent: "▶", title: "play (Space)" }), clock = make("output", { id: "clock" });
  const bar = make("input", { id: "bar", type: "range", title: "time" }), marks = make("div", { id: "marks" });
  const speed = make("select", { id: "speed", title: "speed" }, ...SPEEDS.map(value => option(value, value < 1 ? `1/${Math.round(1 / value)} of real time` : value === 1 ? "real time" : `${value} × real time`)));
  const names = runs.flatMap((run, k) => run.bodies.map(body => ({ value: `${k}\0${body.name}`, text: `follow ${runs.length > 1 ? `${"AB"[k]}: ` : ""}${body.name}` })));
  const follow = make("select", { id: "follow", title: "what the camera follows (F)" }, option("", "camera at rest"), option("\0net", "follow the net"), ...names.map(({ value, text }) => option(value, text)));
  const measure = make("button", { textContent: "Measure", title: "distance of two points (M)" }), picture = make("button", { textContent: "Save PNG", title: "save this picture (P)" });
  const fitButton = make("button", { textContent: "Fit", title: "fit all (0)" }), themeButton = make("button", { textContent: "Light/dark", title: "light or dark (T)" });
  const help = make("details", { id: "help" }, make("summary", { textContent: "Keys" }), make("table", {}, ...KEYS.map(([key, text]) => make("tr", {}, make("th", { textContent: key }), make("td", { textContent: text })))));
  view.append(labels, legend, status);
  const note = runs.map(run => run.verdict).filter(Boolean).join(" · ");
  document.body.append(
    make("header", {}, ...outcomes, make("h1", { textContent: heading }), make("span", { id: "sub", textContent: runs.map(run => run.size_words).join("  |  ") }), ...(note && !outcomes.length ? [make("strong", { textContent: note })] : []), make("nav", {}, fitButton, measure, picture, themeButton, help)),
    view, aside, make("footer", {}, play, clock, make("div", { className: "track" }, marks, bar), speed, follow));

  // The scene
  const renderer = new THREE.WebGLRenderer({ antialias: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setScissorTest(true);
  renderer.autoClear = true;
  view.prepend(renderer.domElement);
  const camera = new THREE.PerspectiveCamera(36, 1, 0.01, 1000);
  camera.up.set(...runs[0].up);
  const side = new THREE.Vector3(1, 0, 0), front = new THREE.Vector3();
  if (Math.abs(camera.up.x) > 0.9) side.set(0, 0, 1);
  side.addScaledVector(camera.up, -side.dot(camera.up)).normalize();
  front.crossVectors(side, camera.up);
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.enableDamping = true;
  controls.dampingFactor = 0.15;
  controls.zoomToCursor = true;
  const scenes = runs.map(run => new RunScene(run));
  const begin = Math.min(...runs.map(run => run.time[0])), end = Math.max(...runs.map(run => run.time[run.frames - 1]));
  const tensionMax = Math.max(...runs.map(run => run.tensionMax));
  const forceMax = Math.max(0, ...runs.flatMap(run => run.bodies.flatMap(({ force }) => Array.from({ length: force.length / 3 }, (_, k) => Math.hypot(force[3 * k], force[3 * k + 1], force[3 * k + 2])))));
  const perMetre = forceMax ? forceMax / (ARROW * Math.max(...runs.map(run => run.size))) : 1, newton = round(perMetre); // an arrow of 1 m [N]
  for (const scene of scenes) scene.forceLength = 1 / newton;
  let now = begin, playing = false, themeName = "light", chosenPoints = [], measuring = false, followed = null, dirty = true;

  // Axes of the scene, drawn in a corner
  const axesScene = new THREE.Scene(), axesCamera = new THREE.OrthographicCamera(-1.5, 1.5, 1.5, -1.5, 0.1, 10);
  const axes = new THREE.AxesHelper(1);
  axesScene.add(axes);
  const axisNames = ["x", "y", "z"].map(name => labels.appendChild(make("span", { className: "axis", textContent: name })));

  const bodyLabels = scenes.map(({ run }) => run.bodies.map(body => labels.appendChild(make("span", { textContent: body.name }))));
  const contactWords = scenes.map(({ run }) => run.bodies.map(body => ({
    force: run.series.filter(series => series.contact === body.name && series.unit),
    count: run.series.filter(series => series.contact === body.name && !series.unit),
  })));
  const runLabels = runs.length > 1 ? runs.map((run, k) => view.appendChild(make("div", { className: "run", textContent: `${"AB"[k]}: ${run.title}` }))) : [];

  // Picked points: a node, or a point of a body in its own axes
  const pickGeometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3));
  const pickLine = new THREE.LineSegments(pickGeometry, new THREE.LineBasicMaterial({ depthTest: false }));
  const pickDots = new THREE.Points(pickGeometry, new THREE.PointsMaterial({ size: 9, sizeAttenuation: false, depthTest: false }));
  for (const item of [pickLine, pickDots]) { item.frustumCulled = false; item.visible = false; item.renderOrder = 9; }
  const pickLabel = labels.appendChild(make("span", { className: "pick" }));

  function placeOf({ scene, node, body, local }) {
    return body === undefined ? new THREE.Vector3().fromArray(scene.at, 3 * node) : local.clone().applyMatrix4(scene.bodies[body].group.matrixWorld);
  }

  function pick(event) {
    const rect = renderer.domElement.getBoundingClientRect(), width = rect.width / runs.length;
    const k = Math.min(runs.length - 1, Math.floor((event.clientX - rect.left) / width)), scene = scenes[k];
    const x = event.clientX - rect.left - k * width, y = event.clientY - rect.top, p = new THREE.Vector3();
    let best = 14, found = null;
    for (let node = 0; node < scene.run.nodes; node++) {
      p.fromArray(scene.at, 3 * node).project(camera);
      const distance = Math.hypot((0.5 + 0.5 * p.x) * width - x, (0.5 - 0.5 * p.y) * rect.height - y);
      if (p.z < 1 && distance < best) { best = distance; found = { scene, node }; }
    }
    if (!found) {
      const ray = new THREE.Raycaster();
      ray.setFromCamera(new THREE.Vector2((2 * x) / width - 1, 1 - (2 * y) / rect.height), camera);
      scene.bodies.forEach(({ group }, body) => {
        const hit = ray.intersectObject(group, true).find(item => item.object.isMesh);
        if (hit && (!found || hit.distance < found.distance)) found = { scene, body, distance: hit.distance, local: group.worldToLocal(hit.point.clone()) };
      });
    }
    if (!found) return;
    if (chosenPoints.length === 2 || (chosenPoints[0] && chosenPoints[0].scene !== scene)) chosenPoints = [];
    chosenPoints.push(found);
    scene.scene.add(pickLine, pickDots);
    if (chosenPoints.length === 2) setMeasuring(false);
    dirty = true;
  }

  function setMeasuring(on) {
    measuring = on;
    measure.classList.toggle("on", on);
    renderer.domElement.style.cursor = on ? "crosshair" : "";
    if (on) { chosenPoints = []; dirty = true; }
  }

  let pressed = null;
  renderer.domElement.addEventListener("pointerdown", event => { pressed = [event.clientX, event.clientY]; });
  renderer.domElement.addEventListener("pointerup", event => {
    if (measuring && pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4) pick(event);
  });

  // Plots and events
  const charts = new Charts(runs, plots, time => set(time));
  charts.range = begin < end ? [begin, end] : [begin - 0.5, begin + 0.5];
  const groups = charts.groups();
  more.append(option("", "+ add a plot …"), ...groups.map((group, k) => option(k, titleOf(group))));
  more.onchange = () => { if (more.value !== "") charts.add(groups[more.value]); more.value = ""; };
  const allEvents = runs.flatMap((run, k) => run.events.map(([time, words, remark]) => [time, runs.length > 1 ? `${"AB"[k]}: ${words}` : words, remark]));
  for (const [time, words, remark] of allEvents.sort((a, b) => a[0] - b[0])) {
    const text = `${+time.toPrecision(4)} s  ${words}`, title = remark ? `${text}\n${remark}` : text, mark = make("button", { title, onclick: () => set(time) });
    events.append(make("button", { textContent: text, title, onclick: () => set(time) }));
    mark.style.left = `${(100 * (time - begin)) / (end - begin || 1)}%`;
    marks.append(mark);
  }

  // Colours
  function limits() {
    const relative = endChoice.value === "strength";
    const largest = endChoice.value !== "now" ? tensionMax : Math.max(1e-9, ...scenes.map(({ run }) => {
      const [low, high, part] = interval(run.time, now), frame = part < 0.5 ? low : high;
      let most = 0;
      for (let e = frame * run.elementCount, stop = e + run.elementCount; e < stop; e++) most = Math.max(most, run.tension[e]);
      return most;
    }));
    return { relative, largest };
  }

  function showLegend() {
    const { relative, largest } = limits(), scale = SCALES[scaleChoice.value];
    const title = relative ? `Tension / strength, ${scale.label}` : `Tension [N] of elements, to the largest ${endChoice.value === "now" ? "now" : "of the states shown"}, ${scale.label}`;
    if (legendTitle.textContent !== title) legendTitle.textContent = title;
    const ticks = [0, 0.25, 0.5, 0.75, 1].map(p => (p === 0 ? (scaleChoice.value === "log" ? `≤ ${digits(1e-3 * (relative ? 1 : largest))}` : "0") : digits(scale.back(p) * (relative ? 1 : largest))));
    if (legendTicks.textContent !== ticks.join("")) legendTicks.replaceChildren(...ticks.map(textContent => make("span", { textContent })));
    for (const scene of scenes) Object.assign(scene.look, { relative, end: largest, scale: scaleChoice.value });
  }

  function setTheme(name) {
    themeName = name;
    document.documentElement.dataset.theme = name;
    const theme = THEMES[name], css = getComputedStyle(document.documentElement);
    scenes.forEach(scene => scene.setTheme(theme));
    legendBar.style.background = `linear-gradient(90deg, ${theme.stops.map(hex).join(",")})`;
    pickLine.material.color.set(theme.pick);
    pickDots.material.color.set(theme.pick);
    showSigns(theme);
    charts.setTheme(theme, css.getPropertyValue("--ink2").trim(), css.getPropertyValue("--grid").trim());
    set(now);
  }

  function showSigns(theme) {
    const { relative } = limits();
    signs.replaceChildren(...SIGNS.filter(sign => runs.some(run => sign.of(run, relative))).map(({ draw, words, color }) => {
      const sign = make("canvas", { width: 48, height: 24 }), pen = sign.getContext("2d");
      pen.scale(2, 2);
      pen.strokeStyle = pen.fillStyle = hex(theme[color]);
      draw(pen);
      return make("span", {}, sign, typeof words === "function" ? words(newton) : words);
    }));
  }

  // Threads are at least as wide as a pixel or two at the distance of what the camera looks at.
  let posed = 0;
  function poseAll() {
    posed = camera.position.distanceTo(controls.target);
    const pixel = (2 * posed * Math.tan((camera.fov * Math.PI) / 360)) / view.clientHeight;
    for (const scene of scenes) scene.pose(now, 0.75 * pixel);
  }

  // Time
  function set(time) {
    now = Math.min(end, Math.max(begin, time));
    bar.value = now;
    clock.textContent = `${now.toFixed(decimals)} s`;
    showLegend();
    poseAll();
    const drawn = scenes.map(({ run, frame }) => (now > run.time[run.frames - 1] ? Infinity : run.time[frame]));
    charts.show(now, drawn);
    clock.title = `numbers beside plots and forces are of the nearest stored state: ${digits(Math.min(...drawn), 6)} s`;
    const words = scenes.flatMap(({ run }, k) => run.bodies.flatMap((body, b) => {
      const { force, count } = contactWords[k][b];
      if (now > run.time[run.frames - 1]) return [];
      const value = series => valueAt(series.time, series.values, drawn[k]) ?? 0; // as what is drawn
      const threads = Math.round(count.reduce((sum, series) => sum + value(series), 0));
      const { arrow } = scenes[k].bodies[b], resultant = arrow ? `, resultant ${digits(arrow.visible ? arrow.scale.x * newton : 0)} N` : "";
      return threads ? [`${runs.length > 1 ? `${"AB"[k]}: ` : ""}${body.name}: ${threads} ${threads === 1 ? "contact presses" : "contacts press"} with ${digits(force.reduce((sum, series) => sum + value(series), 0))} N${resultant}`] : [];
    })).concat(runs.flatMap((run, k) => (now > run.time[run.frames - 1] ? [`${runs.length > 1 ? `${"AB"[k]}: ` : ""}ended at ${digits(run.time[run.frames - 1])} s`] : []))).concat(scenes.flatMap(({ run }, k) => run.reels.map(reel => `${runs.length > 1 ? `${"AB"[k]}: ` : ""}${reel.name}: ${digits(valueAt(run.seriesTime, run.series[reel.series].values, drawn[k]))} m wound up`))).join("\n");
    if (status.textContent !== words) status.textContent = words;
    if (followed) {
      const place = followedPlace(), moved = place.clone().sub(followed);
      camera.position.add(moved);
      controls.target.add(moved);
      followed = place;
    }
    dirty = true;
  }

  const step = Math.min(...runs.map(run => (run.time[run.frames - 1] - run.time[0]) / Math.max(1, run.frames - 1))) || 1e-3;
  const decimals = Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(step))));
  bar.min = begin; bar.max = end; bar.step = (end - begin) / 4000 || 1;
  bar.oninput = () => set(+bar.value);

  function setPlaying(on) {
    playing = on;
    play.textContent = on ? "❚❚" : "▶";
    if (on && now >= end) set(begin);
  }

  const everyTime = [...new Set(runs.flatMap(run => Array.from(run.time)))].sort((a, b) => a - b);
  function move(states) {
    const time = everyTime, [low, , part] = interval(time, now);
    const k = states < 0 && part > 1e-6 ? low + 1 + states : low + states;
    set(time[Math.max(0, Math.min(time.length - 1, k))]);
  }

  // Camera
  function fit(direction = null) {
    const box = new THREE.Box3(), [of, name] = follow.value.split("\0");
    if (followed) (of === "" ? scenes : [scenes[of]]).forEach(scene => scene.bounds(box, of === "" ? "" : name));
    else for (const scene of scenes) {
      scene.bounds(box);
      for (const time of [begin, (begin + end) / 2, end]) { scene.pose(time); scene.scene.updateMatrixWorld(true); scene.bounds(box); }
    }
    set(now);
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    if (followed) { sphere.radius += sphere.center.distanceTo(followed); sphere.center.copy(followed); }
    const radius = Math.max(sphere.radius, 1e-6);
    const way = direction ? new THREE.Vector3(...direction) : camera.position.clone().sub(controls.target);
    if (way.length() === 0) way.set(...runs[0].direction);
    const half = Math.min(camera.fov, 2 * Math.atan(Math.tan((camera.fov * Math.PI) / 360) * camera.aspect) * (180 / Math.PI)) / 2;
    controls.target.copy(sphere.center);
    camera.position.copy(sphere.center).add(way.setLength((0.85 * radius) / Math.sin((half * Math.PI) / 180)));
    camera.near = radius / 500;
    camera.far = radius * 100;
    camera.updateProjectionMatrix();
    dirty = true;
  }

  function followedPlace() {
    const [run, name] = follow.value.split("\0");
    return (run === "" ? scenes[0].centre : scenes[+run].place(name)).clone();
  }

  // The camera keeps its distance and looks at what it follows.
  function setFollow(value) {
    follow.value = value;
    followed = value ? followedPlace() : null;
    if (!followed) return;
    camera.position.add(followed).sub(controls.target);
    controls.target.copy(followed);
    dirty = true;
  }

  function resize() {
    if (NARROW.matches) aside.insertBefore(legend, events); else view.append(legend);
    renderer.setSize(view.clientWidth, view.clientHeight);
    camera.aspect = view.clientWidth / runs.length / view.clientHeight;
    camera.updateProjectionMatrix();
    charts.resize();
    runLabels.forEach((label, k) => { label.style.left = `${(100 * k) / runs.length}%`; });
    dirty = true;
  }

  // Labels beside points of the scene; a label that would cover another is hidden.
  let named = true;
  function placeLabels(width, height) {
    const taken = [];
    const put = (label, point, k, shown) => {
      const p = point.clone().project(camera), x = (k + 0.5 + 0.5 * p.x) * width, y = (0.5 - 0.5 * p.y) * height;
      const free = shown && p.z < 1 && Math.abs(p.x) < 1 && Math.abs(p.y) < 1 && taken.every(([a, b]) => Math.abs(a - x) > 70 || Math.abs(b - y) > 18);
      label.style.display = free ? "" : "none";
      if (free) { taken.push([x, y]); label.style.transform = `translate(${x + 10}px, ${y - 9}px)`; }
    };
    const show = chosenPoints.length > 0;
    pickLine.visible = chosenPoints.length === 2;
    pickDots.visible = show;
    if (show) {
      const [first, last] = [placeOf(chosenPoints[0]), placeOf(chosenPoints.at(-1))];
      pickGeometry.attributes.position.copyArray([...first.toArray(), ...last.toArray()]);
      pickGeometry.attributes.position.needsUpdate = true;
      const words = chosenPoints.map(point => (point.body === undefined ? point.scene.run.nodeWords[point.node] ?? `node ${point.node}` : point.scene.run.bodies[point.body].name));
      pickLabel.textContent = chosenPoints.length === 2 ? `${digits(first.distanceTo(last), 4)} m (${words.join(" to ")})` : words[0];
      put(pickLabel, first.add(last).multiplyScalar(0.5), scenes.indexOf(chosenPoints[0].scene), true);
    } else pickLabel.style.display = "none";
    scenes.forEach((scene, k) => scene.bodies.forEach(({ group }, b) => put(bodyLabels[k][b], group.position, k, named)));
  }

  function render() {
    const width = view.clientWidth / runs.length, height = view.clientHeight;
    if (Math.abs(camera.position.distanceTo(controls.target) / posed - 1) > 0.02) poseAll();
    scenes.forEach((scene, k) => {
      scene.sun.target.position.copy(controls.target);
      scene.sun.position.copy(camera.position).add(new THREE.Vector3(0.5, 0.3, 0.9).applyQuaternion(camera.quaternion).multiplyScalar(camera.position.distanceTo(controls.target)));
      renderer.setViewport(k * width, 0, width, height);
      renderer.setScissor(k * width, 0, width, height);
      renderer.render(scene.scene, camera);
    });
    const size = 84;
    axesCamera.position.copy(camera.position).sub(controls.target).setLength(5);
    axesCamera.up.copy(camera.up);
    axesCamera.lookAt(0, 0, 0);
    renderer.setViewport(view.clientWidth - size - 6, 6, size, size);
    renderer.setScissor(view.clientWidth - size - 6, 6, size, size);
    renderer.autoClear = false;
    renderer.clearDepth();
    renderer.render(axesScene, axesCamera);
    renderer.autoClear = true;
    axisNames.forEach((label, k) => {
      const p = new THREE.Vector3().setComponent(k, 1.25).project(axesCamera);
      label.style.transform = `translate(${view.clientWidth - size - 9 + (0.5 + 0.5 * p.x) * size}px, ${height - size - 15 + (0.5 - 0.5 * p.y) * size}px)`;
    });
    placeLabels(width, height);
  }

  function save() {
    render();
    const { canvas, ratio } = { canvas: renderer.domElement, ratio: renderer.getPixelRatio() };
    const page = make("canvas", { width: canvas.width, height: canvas.height }), pen = page.getContext("2d");
    pen.drawImage(canvas, 0, 0);
    pen.scale(ratio, ratio);
    const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim(), height = canvas.height / ratio;
    pen.font = "14px system-ui, sans-serif";
    pen.fillStyle = ink;
    pen.fillText(`${heading}   t = ${clock.textContent}`, 16, 26);
    pen.font = "12px system-ui, sans-serif";
    for (const { style, textContent } of labels.children) {
      const [x, y] = (style.transform.match(/-?[\d.]+/g) ?? []).map(Number);
      if (style.display !== "none") pen.fillText(textContent, x, y + 13);
    }
    runLabels.forEach((label, k) => pen.fillText(label.textContent, 16 + (k * canvas.width) / ratio / runs.length, 46));
    pen.fillText(legendTitle.textContent, 16, height - 44);
    [...signs.children].forEach((sign, k) => { pen.drawImage(sign.firstChild, 16, height - 78 - 18 * k, 24, 12); pen.fillText(sign.textContent, 46, height - 68 - 18 * k); });
    const gradient = pen.createLinearGradient(16, 0, 236, 0);
    THEMES[themeName].stops.forEach((color, k, all) => gradient.addColorStop(k / (all.length - 1), hex(color)));
    [...legendTicks.children].forEach((tick, k) => pen.fillText(tick.textContent, 16 + 51 * k, height - 12));
    pen.fillStyle = gradient;
    pen.fillRect(16, height - 38, 220, 9);
    return page;
  }

  function download() {
    save().toBlob(blob => {
      const link = make("a", { href: URL.createObjectURL(blob), download: `view_${now.toFixed(decimals)}s.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }

  // Actions
  play.onclick = () => setPlaying(!playing);
  scaleChoice.value = "root";
  scaleChoice.onchange = endChoice.onchange = () => { showLegend(); showSigns(THEMES[themeName]); set(now); };
  follow.onchange = () => setFollow(follow.value);
  measure.onclick = () => setMeasuring(!measuring);
  picture.onclick = download;
  fitButton.onclick = () => fit();
  themeButton.onclick = () => setTheme(themeName === "dark" ? "light" : "dark");
  const faster = by => { speed.selectedIndex = Math.max(0, Math.min(SPEEDS.length - 1, speed.selectedIndex + by)); };
  const actions = {
    " ": () => setPlaying(!playing), Home: () => set(begin), End: () => set(end), "+": () => faster(1), "-": () => faster(-1), "0": () => fit(),
    1: () => fit(front.toArray()), 2: () => fit(side.toArray()), 3: () => fit(camera.up.clone().addScaledVector(front, 1e-4).toArray()),
    f: () => setFollow(follow.options[(follow.selectedIndex + 1) % follow.options.length].value),
    m: () => setMeasuring(!measuring), l: () => { named = !named; dirty = true; }, p: download, t: () => themeButton.onclick(),
  };
  addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    if ([" ", "Enter"].includes(event.key) && event.target.closest("button, summary")) return; // presses it
    const arrow = { ArrowLeft: -1, ArrowRight: 1 }[event.key], action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (arrow) move(arrow * (event.shiftKey ? 10 : 1)); else if (action) action(); else return;
    event.preventDefault();
    if (event.target !== document.body) event.target.blur();
  });
  addEventListener("click", event => { if (event.detail) event.target.closest?.("button")?.blur(); }); // Space plays after a click
  addEventListener("resize", resize);

  // On paper: the picture as it is saved, in light colours
  let printed = null;
  addEventListener("beforeprint", () => {
    for (const element of document.querySelectorAll(".section")) element.open = true;
    printed = { theme: themeName, sheet: view.appendChild(Object.assign((setTheme("light"), save()), { id: "sheet" })) };
  });
  addEventListener("afterprint", () => { printed.sheet.remove(); setTheme(printed.theme); });

  // Start
  const wanted = (end - begin) / 10; // whole run in ten seconds
  speed.value = SPEEDS.reduce((best, value) => (Math.abs(Math.log(value / wanted)) < Math.abs(Math.log(best / wanted)) ? value : best));
  setTheme(matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  groups.filter(group => group.shown < HIDDEN).sort((a, b) => a.shown - b.shown).forEach(group => charts.add(group));
  resize();
  set(runs[0].open);
  if (runs[0].follows) setFollow("\0net");
  fit(runs[0].direction);
  let then = performance.now();
  const measured = { frames: 0, script: 0 };
  function loop(time) {
    requestAnimationFrame(loop);
    const passed = Math.min(0.2, (time - then) / 1000), start = performance.now();
    then = time;
    if (playing) { set(now + passed * speed.value); if (now >= end) setPlaying(false); }
    if (controls.update() || dirty) {
      dirty = false;
      render();
      measured.frames++;
      measured.script += performance.now() - start;
    }
  }
  requestAnimationFrame(loop);
  window.viewer = { runs, scenes, set, fit, move, setTheme, setFollow, setPlaying, setMeasuring, render, save, measured, camera, controls, renderer, get now() { return now; }, get points() { return chosenPoints; } };
  document.documentElement.dataset.ready = "true";
}

main().catch(error => { document.body.textContent = `This page cannot be shown: ${error.message}`; throw error; });
