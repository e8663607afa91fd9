/** What the worker that reads the points of pictures is asked, and answers. */
import type { NoPixels, PictureHead, Pixels } from './pixels';

export interface PixelsAsked {
  head: PictureHead;
  bytes: Uint8Array<ArrayBuffer>;
}

export type Drawn = NoPixels | (Pick<Pixels, 'note' | 'range'> & { bitmap: ImageBitmap });
