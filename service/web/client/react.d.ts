/** A React hook that follows boxes through a video, and an overlay that shows them. */

import type { ReactElement, RefObject, SVGProps } from "react";
import type { Box, Client, CreateOptions, MFCMTError, SendOptions, Size, Source, Stream, StreamOptions, StreamStatus, Target, TargetsMessage } from "./mfcmt.js";
import type { Shown } from "./view.js";

export interface TrackerOptions {
  /** For `Client.createSession`; `maxSide` and `quality` are also the stream's. */
  session?: Omit<CreateOptions, "frame" | "box" | "boxes">;
  /** For `Session.stream`. */
  stream?: StreamOptions;
  /** The most frames a second that are sent of a video. */
  fps?: number;
}

export interface Tracker {
  status: "idle" | "starting" | StreamStatus;
  targets: Target[];
  /** The size that the boxes are pixels of; null before the first result. */
  size: Size | null;
  /** What went wrong last; null if nothing did. */
  error: MFCMTError | null;
  /** Start on what the source shows, in place of a run before. A video is followed; of other sources send the next frames. */
  start(source: Source, ...boxes: (Box | number[])[]): Promise<void>;
  stop(): void;
  add(box: Box | number[]): Promise<TargetsMessage>;
  correct(target: number, box: Box | number[]): Promise<TargetsMessage>;
  remove(target: number): Promise<TargetsMessage>;
  send(frame: Source, options?: SendOptions): Promise<number | null>;
  stream: Stream | null;
}

/** Follow boxes through a video. The run ends with the component, and with another `client`: keep one client. */
export function useTracker(client: Client, options?: TrackerOptions): Tracker;

export interface OverlayProps extends Omit<SVGProps<SVGSVGElement>, "ref"> {
  /** The element that the overlay lies over, a sibling of it in a positioned element. */
  of: RefObject<Shown | null>;
  targets?: readonly Target[];
  /** The size that the boxes are pixels of; by default that of what the element shows. */
  size?: Size | null;
  /** With it the user can draw boxes. */
  onBox?: ((box: Box) => void) | null;
  /** A text for a target. */
  label?: (target: Target) => string;
}

export function Overlay(props: OverlayProps): ReactElement;
