/** Helpers for pages that show a picture and the boxes in it. */

import type { Box, Instance, Signal, Size, Target } from "./mfcmt.js";

export type Point = [number, number];
export type Fit = "contain" | "cover" | "fill" | "none" | "scale-down";
/** A `<video>`, `<img>` or `<canvas>` that is shown. */
export type Shown = Instance<"HTMLVideoElement" | "HTMLImageElement" | "HTMLCanvasElement">;

/** Where a picture lies in an area. */
export interface Letterbox {
  /** The picture's own place in the area. */
  area: Box;
  point(point: Point | number[]): Point;
  box(box: Box | number[]): Box;
  /** From the area to the picture. */
  pointBack(point: Point | number[]): Point;
  boxBack(box: Box | number[]): Box;
}

/** Where a picture of a size lies in an area of a size; `fit` (default `contain`) and `position` (fractions, default the middle) as in CSS. */
export function letterbox(size: Size | number[], area: Size | number[], options?: { fit?: Fit; position?: Point }): Letterbox;
/** Where a picture lies in the content box of an element, by its `object-fit` and `object-position`. */
export function letterboxOf(element: Shown, size?: Size): Letterbox;
/** The size of what an element shows, in its own pixels. */
export function sourceSize(element: Shown): Size;

export interface DrawOptions {
  /** What has been drawn so far; null when it is done or given up. */
  onDraft?: (box: Box | null) => void;
  signal?: Signal;
}

/** Let the user draw boxes on an element, in pixels of what it shows; returns the function that ends that. */
export function drawBoxes(element: Shown, onBox: (box: Box) => void, options?: DrawOptions): () => void;

export interface OverlayOptions {
  /** A text for a target. */
  label?: (target: Target) => string;
  /** An element to draw in, a sibling of the one that it lies over; by default one is made. */
  svg?: Instance<"SVGSVGElement">;
}

export interface OverlayLayer {
  readonly svg: Instance<"SVGSVGElement">;
  /** Show the targets of a result; `size` is the result's, by default the size of what the element shows. */
  draw(targets: readonly Target[], size?: Size | null): void;
  /** Show a box that is being drawn, or none. */
  draft(box: Box | null): void;
  remove(): void;
}

/** Lay an SVG with boxes over an element. Lines have the class `mfcmt-STATUS`. */
export function overlay(element: Shown, options?: OverlayOptions): OverlayLayer;
