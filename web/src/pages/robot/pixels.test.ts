import { describe, expect, it } from 'vitest';
import { isShownEncoding, type PictureHead, pixelsOf, type Pixels, SHOWN_ENCODINGS } from './pixels';

function head(encoding: string, width: number, height: number, step: number, bytes: number, more = {}): PictureHead {
  return { type: 'raw', bytes, s: 0, t: null, encoding, width, height, step, is_bigendian: 0, ...more };
}

function points(encoding: string, width: number, step: number, bytes: number[], more = {}): number[][] {
  const height = Math.ceil(bytes.length / step);
  const found = pixelsOf(head(encoding, width, height, step, bytes.length, more), new Uint8Array(bytes));
  expect(found).not.toHaveProperty('problem');
  const { rgba } = found as Pixels;
  return Array.from({ length: width * height }, (_, at) => [...rgba.slice(4 * at, 4 * at + 4)]);
}

describe('the points of a picture', () => {
  it.each([
    ['rgb8', [1, 2, 3], [1, 2, 3, 255]],
    ['bgr8', [1, 2, 3], [3, 2, 1, 255]],
    ['8UC3', [1, 2, 3], [3, 2, 1, 255]],
    ['rgba8', [1, 2, 3, 0], [1, 2, 3, 255]],
    ['bgra8', [1, 2, 3, 0], [3, 2, 1, 255]],
    ['8UC4', [1, 2, 3, 0], [3, 2, 1, 255]],
    ['mono8', [7], [7, 7, 7, 255]],
    ['8UC1', [7], [7, 7, 7, 255]],
    ['bayer_rggb8', [7], [7, 7, 7, 255]],
    ['mono16', [0xff, 0x80], [128, 128, 128, 255]],
    ['bayer_grbg16', [0, 0xff], [254, 254, 254, 255]],
  ])('are read of %s', (encoding, bytes, expected) => {
    expect(points(encoding, 1, bytes.length, bytes)).toEqual([expected]);
    expect(isShownEncoding(encoding)).toBe(true);
  });

  it('have what fills a line up left out, which the last one may not have', () => {
    expect(points('mono8', 2, 3, [1, 2, 99, 3, 4])).toEqual([1, 2, 3, 4].map((one) => [one, one, one, 255]));
  });

  it('have the order of bytes that the camera says', () => {
    expect(points('mono16', 1, 2, [0xff, 0x01], { is_bigendian: 1 })[0]?.[0]).toBe(254);
    expect(points('mono16', 1, 2, [0xff, 0x01], { is_bigendian: 0 })[0]?.[0]).toBe(2);
  });

  it('go from the nearest to the farthest of a depth, and are black where nothing was measured', () => {
    const bytes = new Uint8Array(new Uint16Array([0, 500, 1500, 2500]).buffer);
    const found = pixelsOf(head('16UC1', 4, 1, 8, 8), bytes) as Pixels;
    expect([0, 1, 2, 3].map((at) => found.rgba[4 * at])).toEqual([0, 0, 128, 255]);
    expect(found.range).toEqual([500, 2500]);
    expect((pixelsOf(head('16UC1', 1, 1, 2, 2), new Uint8Array(2)) as Pixels).range).toEqual([0, 0]);
  });

  it('are said to be the pattern of a sensor', () => {
    expect((pixelsOf(head('bayer_bggr8', 1, 1, 1, 1), new Uint8Array(1)) as Pixels).note).toBe('bayer');
    expect((pixelsOf(head('mono8', 1, 1, 1, 1), new Uint8Array(1)) as Pixels).note).toBe('');
  });

  it.each([
    ['encoding', head('yuv422', 1, 1, 2, 2), 2],
    ['encoding', head('toString', 1, 1, 2, 2), 2],
    ['encoding', { ...head('', 1, 1, 1, 1), encoding: null }, 1],
    ['large', head('rgb8', 2000, 2000, 6000, 12_000_000), 0],
    ['large', head('mono8', 60_000, 60_000, 60_000, 9), 9],
    ['torn', head('rgb8', 2, 2, 6, 11), 11],
    ['torn', head('rgb8', 2, 2, 5, 99), 99],
    ['torn', head('rgb8', 0, 2, 6, 12), 12],
    ['torn', head('rgb8', 2.5, 1, 9, 12), 12],
    ['torn', { ...head('rgb8', 1, 1, 3, 3), width: { int: '99999999999999999999' } }, 3],
  ] as const)('are none: %s', (problem, said, bytes) => {
    expect(pixelsOf(said, new Uint8Array(bytes))).toEqual({ problem });
  });

  it('of encodings that are not shown are none, and people are told which are', () => {
    for (const one of ['32FC1', 'yuv422_yuy2', 'rgb16', 'constructor', '']) expect(isShownEncoding(one)).toBe(false);
    for (const one of SHOWN_ENCODINGS.split(', ')) expect(isShownEncoding(one.replace('*', 'rggb'))).toBe(true);
  });
});
