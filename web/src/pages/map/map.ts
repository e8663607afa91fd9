/** Where robots and places are, what of the plane is seen, and how it is moved. Metres; x to the right, y up. */
import { qualityOf } from '../../lib/value';
import { hasFault, type Robot, type Standing, standingOf } from '../fleet/robots';

/** An entry `robot/NAME` of the feed `positions`; null: not known. */
export interface Position {
  name: string;
  x: number | null;
  y: number | null;
  /** Radians counterclockwise from the x axis; null: not told. */
  heading: number | null;
  s: number;
  t: string | null;
  frame: string;
}

export interface Place {
  name: string;
  x: number;
  y: number;
}

export interface Marker {
  name: string;
  x: number;
  y: number;
  heading: number | null;
  /** Whether it is there now; else it was there. */
  now: boolean;
  standing: Standing;
  /** Whether something of it is out of order, also where it does something else meanwhile. */
  faulty: boolean;
  /** The first of its faults in words; empty: none is told. */
  fault: string;
  time: string | null;
  frame: string;
}

export interface Seen {
  markers: Marker[];
  places: Place[];
  /** Robots that do not say where they are, by name. */
  missing: string[];
}

/** Robots and places that have a place on the map, each by name. */
export function seenOf(
  entries: ReadonlyMap<string, unknown>,
  robots: ReadonlyMap<string, Robot>,
  current: boolean,
): Seen {
  const markers: Marker[] = [];
  const places: Place[] = [];
  for (const [key, value] of entries) {
    if (key.startsWith('place/')) places.push(value as Place);
    if (!key.startsWith('robot/')) continue;
    const one = value as Position;
    if (one.x === null || one.y === null) continue;
    const robot = robots.get(one.name);
    markers.push({
      name: one.name,
      x: one.x,
      y: one.y,
      heading: one.heading,
      now: current && qualityOf(one.s) === 'good',
      standing: robot ? standingOf(robot) : 'unknown',
      faulty: robot ? standingOf(robot) === 'faulted' || hasFault(robot) : false,
      fault: robot?.fault ?? '',
      time: one.t,
      frame: one.frame,
    });
  }
  const shown = new Set(markers.map((one) => one.name));
  const byName = (a: { name: string }, b: { name: string }) => a.name.localeCompare(b.name);
  return {
    markers: markers.sort(byName),
    places: places.sort(byName),
    missing: [...robots.keys()].filter((name) => !shown.has(name)).sort((a, b) => a.localeCompare(b)),
  };
}

/** What is seen: the point in the middle, and how many pixels a metre is. */
export interface View {
  x: number;
  y: number;
  scale: number;
}

export interface Size {
  width: number;
  height: number;
}

const LEAST_SCALE = 0.001;
const MOST_SCALE = 2000;
const MARGIN_PX = 48;

const clamp = (value: number, least: number, most: number) => Math.min(most, Math.max(least, value));

/** 1, 2 or 5 times a power of ten: the least that is at least `value`. */
export function niceStep(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  const factor = [1, 2, 5].find((one) => one * power >= value * (1 - 1e-9)) ?? 10;
  return factor * power;
}

/**
 * A view that shows all points. It stays as it is while they move a little: their bounds are rounded outward to a step
 * of a tenth of their extent.
 */
export function fitted(points: readonly { x: number; y: number }[], size: Size): View {
  if (points.length === 0) return { x: 0, y: 0, scale: 50 };
  const bounds = (values: number[]): [number, number] => [
    values.reduce((least, one) => Math.min(least, one)),
    values.reduce((most, one) => Math.max(most, one)),
  ];
  const xs = bounds(points.map((one) => one.x));
  const ys = bounds(points.map((one) => one.y));
  const step = niceStep(Math.max(xs[1] - xs[0], ys[1] - ys[0], 2) / 10);
  const rounded = ([least, most]: [number, number]) =>
    [Math.floor(least / step) * step, Math.ceil(most / step) * step] as const;
  const [left, right] = rounded(xs);
  const [below, above] = rounded(ys);
  const wide = Math.max(size.width - 2 * MARGIN_PX, 20) / Math.max(right - left, 2);
  const high = Math.max(size.height - 2 * MARGIN_PX, 20) / Math.max(above - below, 2);
  return { x: (left + right) / 2, y: (below + above) / 2, scale: clamp(Math.min(wide, high), LEAST_SCALE, MOST_SCALE) };
}

/** Where a point is on the screen. */
export function toScreen(view: View, size: Size, point: { x: number; y: number }): { x: number; y: number } {
  return {
    x: size.width / 2 + (point.x - view.x) * view.scale,
    y: size.height / 2 - (point.y - view.y) * view.scale,
  };
}

/** The view after it was dragged by so many pixels. */
export function moved(view: View, right: number, down: number): View {
  return { ...view, x: view.x - right / view.scale, y: view.y + down / view.scale };
}

/** The view after zooming, in which the same point is under (x, y) of the screen. */
export function zoomed(view: View, size: Size, factor: number, x = size.width / 2, y = size.height / 2): View {
  const scale = clamp(view.scale * factor, LEAST_SCALE, MOST_SCALE);
  const right = (x - size.width / 2) * (1 / view.scale - 1 / scale);
  const up = (size.height / 2 - y) * (1 / view.scale - 1 / scale);
  return { x: view.x + right, y: view.y + up, scale };
}

const PAN_PX = 60;
const ZOOM = 1.25;

/** The view after a key; null: a key of no use. */
export function keyed(view: View, size: Size, key: string): View | null {
  switch (key) {
    case 'ArrowLeft':
      return moved(view, PAN_PX, 0);
    case 'ArrowRight':
      return moved(view, -PAN_PX, 0);
    case 'ArrowUp':
      return moved(view, 0, PAN_PX);
    case 'ArrowDown':
      return moved(view, 0, -PAN_PX);
    case '+':
    case '=':
      return zoomed(view, size, ZOOM);
    case '-':
      return zoomed(view, size, 1 / ZOOM);
    default:
      return null;
  }
}

export interface Grid {
  /** Metres between lines. */
  step: number;
  xs: number[];
  ys: number[];
}

const LINE_PX = 70;

/** The lines of the grid that are seen. */
export function gridOf(view: View, size: Size): Grid {
  const step = niceStep(LINE_PX / view.scale);
  const lines = (middle: number, pixels: number) => {
    const half = pixels / 2 / view.scale;
    const first = Math.ceil((middle - half) / step);
    const count = Math.min(200, Math.max(0, Math.floor((middle + half) / step) - first + 1));
    return Array.from({ length: count }, (_, index) => (first + index) * step);
  };
  return { step, xs: lines(view.x, size.width), ys: lines(view.y, size.height) };
}

/** A length in the unit that makes it short. */
export function formatLength(metres: number): string {
  if (metres >= 1000) return `${+(metres / 1000).toPrecision(3)} km`;
  if (metres >= 1) return `${+metres.toPrecision(3)} m`;
  if (metres >= 0.01) return `${+(metres * 100).toPrecision(3)} cm`;
  return `${+(metres * 1000).toPrecision(3)} mm`;
}

/** A coordinate to the centimetre. */
export function formatMetres(value: number): string {
  const text = Math.abs(value) >= 1e7 ? value.toExponential(3) : value.toFixed(2);
  return (Number(text) === 0 ? '0.00' : text).replace('-', '−');
}

/** A heading in whole degrees, 0 to 359. */
export function formatHeading(radians: number): string {
  return `${((Math.round((radians * 180) / Math.PI) % 360) + 360) % 360}°`;
}

/** A name that fits beside its marker. */
export function shortName(name: string, most = 24): string {
  const signs = [...name];
  return signs.length > most ? `${signs.slice(0, most - 1).join('')}…` : name;
}

const NAME_PX = 90;

/** How a name stands at its marker, so that the edge does not cut it. */
export function anchorOf(x: number, width: number): 'start' | 'middle' | 'end' {
  if (width < 2 * NAME_PX) return 'middle';
  return x < NAME_PX ? 'start' : x > width - NAME_PX ? 'end' : 'middle';
}

const SIGN_PX = 7;
const LINE_HEIGHT_PX = 13;
/** Of a robot with its nose, from its middle. */
const ROBOT_PX = 21;

interface Box {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

export interface Label {
  /** From the marker's point. */
  x: number;
  y: number;
  anchor: 'start' | 'middle' | 'end';
}

interface Named {
  name: string;
  x: number;
  y: number;
}

function boxOf(one: Named, label: Label): Box {
  const wide = [...shortName(one.name)].length * SIGN_PX;
  const x = one.x + label.x;
  const left = label.anchor === 'start' ? x : label.anchor === 'end' ? x - wide : x - wide / 2;
  const bottom = one.y + label.y + 3;
  return { left, right: left + wide, top: bottom - LINE_HEIGHT_PX, bottom };
}

const meet = (a: Box, b: Box) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

/** Names are placed anew each time a robot moves: so many pairs of a place and a robot are looked at. */
const MOST_PAIRS = 20_000;

/** The name of a robot stands above it. */
export const robotLabel = (x: number, width: number): Label => ({ x: 0, y: -22, anchor: anchorOf(x, width) });

/**
 * Where the names of places stand, by points on the screen: below, above or beside, where neither a robot, its name nor
 * another place's name is; below where there is no such side, or too much to look at.
 */
export function placeLabels(places: readonly Named[], robots: readonly Named[], width: number): Label[] {
  const looked = places.length * robots.length <= MOST_PAIRS;
  const taken: Box[] = (looked ? robots : []).flatMap((one) => [
    { left: one.x - ROBOT_PX, right: one.x + ROBOT_PX, top: one.y - ROBOT_PX, bottom: one.y + ROBOT_PX },
    boxOf(one, robotLabel(one.x, width)),
  ]);
  return places.map((one) => {
    const anchor = anchorOf(one.x, width);
    const sides: Label[] = [
      { x: 0, y: 20, anchor },
      { x: 0, y: -12, anchor },
      { x: 24, y: 6, anchor: 'start' },
      { x: -24, y: 6, anchor: 'end' },
    ];
    const free = sides.filter((label) => {
      const { left, right } = boxOf(one, label);
      return left >= 0 && right <= width;
    });
    const label = free.find((side) => !taken.some((box) => meet(box, boxOf(one, side)))) ?? { x: 0, y: 20, anchor };
    taken.push(boxOf(one, label));
    return label;
  });
}
