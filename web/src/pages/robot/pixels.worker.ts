/** Reads the points of pictures in a thread of its own. */
import type { Answer } from '../../lib/worker';
import type { Drawn, PixelsAsked } from './drawn';
import { pixelsOf } from './pixels';

async function drawn({ head, bytes }: PixelsAsked): Promise<Drawn> {
  const pixels = pixelsOf(head, bytes);
  if ('problem' in pixels) return pixels;
  const { rgba, width, height, note, range } = pixels;
  return { bitmap: await createImageBitmap(new ImageData(rgba, width, height)), note, range };
}

addEventListener('message', async (event: MessageEvent<PixelsAsked & { id: number }>) => {
  const { id } = event.data;
  try {
    const found = await drawn(event.data);
    const answer: Answer<Drawn> = { id, found };
    postMessage(answer, { transfer: 'bitmap' in found ? [found.bitmap] : [] });
  } catch (error) {
    postMessage({ id, failed: String(error) } satisfies Answer<Drawn>);
  }
});
