/** The points of a `sensor_msgs/Image` as a canvas takes them. */
import type { Json } from '../../lib/protocol';

/** What the console says of a picture before its bytes. */
export interface PictureHead {
  /** A media type; `raw`: points as they are, as the fields below say; null: it is no picture. */
  type: string | null;
  /** Its size; more than a page is given where it is too large. */
  bytes: number;
  s: number;
  t: string | null;
  encoding?: Json;
  width?: Json;
  height?: Json;
  step?: Json;
  is_bigendian?: Json;
}

export interface Pixels {
  width: number;
  height: number;
  rgba: Uint8ClampedArray<ArrayBuffer>;
  /** `bayer`: the pattern of a sensor, in grey. */
  note: '' | 'bayer';
  /** Values that are black and white, where these are not the least and the greatest that there can be. */
  range: [number, number] | null;
}

/** Why there are no points: an encoding that is not shown; more than is shown; other bytes than the fields say. */
export type NoPixels = { problem: 'encoding' | 'large' | 'torn' };

/** Points of a picture that is shown: as many as a picture of 4 MiB can have. */
const MOST_POINTS = 4 * 1024 * 1024;

interface Layout {
  /** Bytes of a point. */
  size: number;
  /** Where red, green and blue are in it; what is grey has one place for all. Alpha is not looked at. */
  places: readonly [number, number, number];
}

const GREY: Layout = { size: 1, places: [0, 0, 0] };
const LAYOUTS: ReadonlyMap<string, Layout> = new Map([
  ['rgb8', { size: 3, places: [0, 1, 2] }],
  ['rgba8', { size: 4, places: [0, 1, 2] }],
  ['bgr8', { size: 3, places: [2, 1, 0] }],
  ['bgra8', { size: 4, places: [2, 1, 0] }],
  ['mono8', GREY],
  // As OpenCV names them, whose colours are blue, green, red.
  ['8UC1', GREY],
  ['8UC3', { size: 3, places: [2, 1, 0] }],
  ['8UC4', { size: 4, places: [2, 1, 0] }],
]);
const BAYER = /^bayer_(rggb|bggr|gbrg|grbg)(8|16)$/;

/** Encodings that are shown, for people. */
export const SHOWN_ENCODINGS = `${[...LAYOUTS.keys()].join(', ')}, mono16, 16UC1, bayer_*8, bayer_*16`;

/** How many bytes a point has; 0: the encoding is not shown. */
function sizeOf(encoding: string): number {
  const layout = LAYOUTS.get(encoding);
  if (layout) return layout.size;
  if (encoding === 'mono16' || encoding === '16UC1') return 2;
  const bayer = BAYER.exec(encoding);
  return bayer ? Number(bayer[2]) / 8 : 0;
}

export const isShownEncoding = (encoding: string) => sizeOf(encoding) > 0;

/** The points of a picture. */
export function pixelsOf(head: PictureHead, bytes: Uint8Array): Pixels | NoPixels {
  const { encoding, width, height, step } = head;
  const size = typeof encoding === 'string' ? sizeOf(encoding) : 0;
  if (typeof encoding !== 'string' || !size) return { problem: 'encoding' };
  if (head.bytes > bytes.length) return { problem: 'large' };
  if (!isCount(width) || !isCount(height) || !isCount(step)) return { problem: 'torn' };
  if (width * height > MOST_POINTS) return { problem: 'large' };
  if (step < width * size || bytes.length < step * (height - 1) + width * size) return { problem: 'torn' };
  const rgba = new Uint8ClampedArray(4 * width * height);
  const note = BAYER.test(encoding) ? 'bayer' : '';
  const range =
    size === 2
      ? drawWords(rgba, bytes, { width, height, step }, head.is_bigendian === 1, encoding === '16UC1')
      : drawBytes(rgba, bytes, { width, height, step }, LAYOUTS.get(encoding) ?? GREY);
  return { width, height, rgba, note, range };
}

const isCount = (value: Json | undefined): value is number =>
  typeof value === 'number' && Number.isInteger(value) && value > 0;

interface Shape {
  width: number;
  height: number;
  step: number;
}

function drawBytes(rgba: Uint8ClampedArray, bytes: Uint8Array, shape: Shape, layout: Layout): null {
  const { size } = layout;
  const [red, green, blue] = layout.places;
  let to = 0;
  for (let line = 0; line < shape.height; line += 1) {
    let from = line * shape.step;
    for (let column = 0; column < shape.width; column += 1, from += size, to += 4) {
      rgba[to] = bytes[from + red]!;
      rgba[to + 1] = bytes[from + green]!;
      rgba[to + 2] = bytes[from + blue]!;
      rgba[to + 3] = 255;
    }
  }
  return null;
}

/** Points of two bytes in grey. What is `measured`, as a depth, has no greatest value: it goes from least to greatest. */
function drawWords(
  rgba: Uint8ClampedArray,
  bytes: Uint8Array,
  shape: Shape,
  isBigEndian: boolean,
  measured: boolean,
): [number, number] | null {
  const [high, low] = isBigEndian ? [0, 1] : [1, 0];
  const each = (take: (value: number) => void) => {
    for (let line = 0; line < shape.height; line += 1) {
      const end = line * shape.step + 2 * shape.width;
      for (let from = line * shape.step; from < end; from += 2) take((bytes[from + high]! << 8) | bytes[from + low]!);
    }
  };
  let [least, greatest] = [0, 65535];
  if (measured) {
    [least, greatest] = [65535, 0];
    // 0 is: nothing was measured there. It stays black.
    each((value) => {
      if (value && value < least) least = value;
      if (value > greatest) greatest = value;
    });
    if (greatest === 0) least = 0;
  }
  const scale = 255 / Math.max(1, greatest - least);
  let to = 0;
  each((value) => {
    rgba[to] = rgba[to + 1] = rgba[to + 2] = (value - least) * scale;
    rgba[to + 3] = 255;
    to += 4;
  });
  return measured ? [least, greatest] : null;
}
