// Colours of both themes. Scales of tension change in lightness only one way, so that they can be read in grey.
import { Color } from "three";

export const THEMES = {
  dark: {
    background: 0x10151c, slack: 0x6f8097, unknown: 0x2fa37c, stops: [0x6d63c4, 0xb5569f, 0xe8695f, 0xf7a14b, 0xf9ee85],
    target: 0xaeb4bd, chaser: 0x7b8ca6, edge: 0x0b0e13, bullet: 0xe3e8ef, line: 0x5fd0ff, contact: 0xffffff, force: 0x7dff9b, trail: 0x6f8fb8, pick: 0xffd21f,
    sky: 0xffffff, ground: 0x56606e,
    curves: ["#5db5ff", "#f5a030", "#8be39a", "#ef8fbd", "#c9d1dc", "#b79bff"],
  },
  light: {
    background: 0xf3f5f8, slack: 0x94a1b2, unknown: 0x1f8a62, stops: [0x8fb3dd, 0x5e8fc7, 0x8a5aa8, 0xb5294e, 0x4d0a17],
    target: 0xdcdfe4, chaser: 0x8593aa, edge: 0x30353d, bullet: 0x333a44, line: 0x007f9e, contact: 0x000000, force: 0x00802b, trail: 0x8aa0bd, pick: 0x7a3cff,
    sky: 0xffffff, ground: 0x9aa1ab,
    curves: ["#0b5cad", "#b3620a", "#1e7d34", "#a02c68", "#4b5563", "#6741b0"],
  },
};

const STEPS = 255;

// Colours from 0 to 1 in linear light, three numbers each.
export function table(theme) {
  const colors = theme.stops.map(hex => new Color(hex)), found = new Float32Array(3 * (STEPS + 1)), mixed = new Color();
  for (let i = 0; i <= STEPS; i++) {
    const place = (i / STEPS) * (colors.length - 1), k = Math.min(colors.length - 2, Math.floor(place));
    mixed.lerpColors(colors[k], colors[k + 1], place - k).toArray(found, 3 * i);
  }
  return found;
}

export const SCALES = {
  linear: { label: "linear", part: x => x, back: p => p },
  root: { label: "square root", part: Math.sqrt, back: p => p * p },
  log: { label: "logarithmic", part: x => Math.max(0, 1 + Math.log10(Math.max(x, 1e-3)) / 3), back: p => 10 ** (3 * (p - 1)) },
};

// Index into the table of a part of the largest value; -1: slack.
export function step(part, scale) {
  return part > 0 ? Math.round(STEPS * Math.min(1, SCALES[scale].part(part))) : -1;
}
