// Unpacks the data of a page: a mark of 6 bytes, a checksum (4), the length of the header (8), the header in JSON, and
// arrays in the order of its table (`pack_arrays` in exunet/base/files.py).

const START = 18, TYPES = { "<f4": Float32Array, "<f8": Float64Array, "<u4": Uint32Array, "|u1": Uint8Array };

export async function load() {
  const buffer = await window.unpack("data"), length = new Uint32Array(buffer.slice(10, 14))[0];
  const { header, arrays } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, START, length)));
  const found = {};
  let at = START + length;
  for (const [name, type, shape] of arrays) {
    const bytes = TYPES[type].BYTES_PER_ELEMENT * shape.reduce((a, b) => a * b, 1);
    found[name] = new TYPES[type](buffer.slice(at, at + bytes));
    at += bytes;
  }
  header.runs.forEach((run, k) => {
    for (const name in found) if (name.startsWith(`${k}/`)) run[name.slice(2)] = found[name];
    run.bodies.forEach((body, b) => { for (const name of ["position", "attitude", "force", "point", "vertices", "triangles"]) body[name] = run[`body ${b}/${name}`]; });
    run.series.forEach((series, s) => {
      series.values = Array.from(run[`series/${s}/values`], value => (Number.isFinite(value) ? value : null));
      series.time = run[`series/${s}/time`] ?? run.seriesTime;
    });
    run.frames = run.time.length;
    run.elementCount = run.elements.length / 2;
    run.position = decodePositions(run);
    run.tension = decodeTensions(run);
  });
  return header;
}

// Integers of 16 bits, stored as differences over time: a series for each coordinate, low bytes before high bytes.
// `put(row, time, value)` gets the values in order; sums are modulo 2^16, as in the encoder.
function decode(bytes, rows, times, order, put) {
  const high = rows * times;
  for (let row = 0, i = 0; row < rows; row++) {
    let value = 0, slope = 0;
    for (let t = 0; t < times; t++, i++) {
      const code = bytes[i] | (bytes[high + i] << 8);
      const change = (code >>> 1) ^ -(code & 1);
      if (order === 2) { slope += change; value += slope; } else value += change;
      put(row, t, value & 0xffff);
    }
  }
}

function decodePositions({ positions, frames, nodes, resolution, corner }) {
  const found = new Float32Array(frames * nodes * 3), width = 3 * nodes;
  decode(positions, width, frames, 2, (row, t, value) => { found[t * width + row] = value * resolution + corner[row % 3]; });
  return found;
}

// Square-root scale: fine steps for small tensions.
function decodeTensions({ tensions, frames, elementCount, tensionMax }) {
  const found = new Float32Array(frames * elementCount);
  decode(tensions, elementCount, frames, 1, (row, t, value) => { const part = value / 65535; found[t * elementCount + row] = tensionMax * part * part; });
  return found;
}

// The interval of stored times around a time, and the part of it that has passed.
export function interval(times, time) {
  let low = 0, high = times.length - 1;
  while (low < high) { const middle = (low + high + 1) >> 1; if (times[middle] <= time) low = middle; else high = middle - 1; }
  if (low >= times.length - 1) return [times.length - 1, times.length - 1, 0];
  return [low, low + 1, Math.min(1, Math.max(0, (time - times[low]) / (times[low + 1] - times[low])))];
}

export function valueAt(times, values, time) {
  const [a, b, part] = interval(times, time);
  return values[a] === null || values[b] === null ? null : values[a] * (1 - part) + values[b] * part;
}

// Largest of 1, 2, 5 times a power of ten that is not above a value.
export function round(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [5, 2, 1].find(k => k * power <= value * (1 + 1e-9));
}

export function digits(value, count = 3) {
  if (value === null || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-3 ? value.toExponential(count - 1) : size >= 10 ** count ? value.toFixed(0) : value.toPrecision(count);
  return text.replace("-", "−");
}
