// A canvas that shows pictures. Each picture is decoded before it replaces the one that is shown.

export class PictureView {
  private asked = 0;
  private shown = 0;
  private last: Blob | null = null;
  private readonly context: ImageBitmapRenderingContext;

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext("bitmaprenderer")!;
  }

  /**
   * Show a picture as soon as it is decoded; until then the previous one stays. Its text goes to `data-frame`.
   *
   * Resolves to whether it was shown: not if the same or a newer one is shown by then, or after `clear`. Rejects if the
   * browser cannot decode it.
   */
  async show(picture: Blob, frame: string): Promise<boolean> {
    if (picture === this.last) {
      return false;
    }
    this.last = picture;
    const order = ++this.asked;
    const bitmap = await createImageBitmap(picture);
    if (order <= this.shown) {
      bitmap.close();
      return false;
    }
    this.shown = order;
    this.resize(bitmap.width, bitmap.height);
    this.context.transferFromImageBitmap(bitmap);
    this.canvas.dataset["frame"] = frame;
    return true;
  }

  /** Show nothing, also when a picture that was asked for before is decoded later. */
  clear(): void {
    this.shown = this.asked;
    this.last = null;
    this.context.transferFromImageBitmap(null);
    delete this.canvas.dataset["frame"];
  }

  private resize(width: number, height: number): void {
    if (this.canvas.width !== width || this.canvas.height !== height) {
      Object.assign(this.canvas, { width, height });
    }
  }
}
