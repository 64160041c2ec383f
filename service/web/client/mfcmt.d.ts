/**
 * Client of the MFCMT tracking service, for browsers, Node and React Native. Wire objects keep the protocol's names
 * (docs/protocol.md).
 */

/**
 * What a global class makes, where the project's libraries have it (DOM, `@types/node`); else never. So these types need no
 * library beside ECMAScript's.
 */
export type Instance<Name extends string> = Name extends string
  ? typeof globalThis extends { [name in Name]: { prototype: infer Made } }
    ? Made
    : never
  : never;
/** Bytes of their own, which a Blob may be made of in every version of TypeScript. */
export type Bytes = Uint8Array & { readonly buffer: ArrayBuffer };
/** An AbortSignal. */
export interface Signal {
  readonly aborted: boolean;
  readonly reason?: any;
  addEventListener(type: "abort", listener: () => void, options?: any): void;
  removeEventListener(type: "abort", listener: () => void): void;
}

/**
 * `[x, y, w, h]`: pixels of the whole frame, 0-based, top-left corner, `w, h > 0`; of the frame as it is sent, or of its
 * source (`ClientOptions.boxesIn`).
 */
export type Box = [number, number, number, number];
/** `[x, y, w, h]` in whole pixels of the frame. */
export type Region = [number, number, number, number];
/** `[w, h]` in pixels. */
export type Size = [number, number];

export type Codec = "json" | "msgpack";
/** One value for each of: the fused map, the template map, the statistical map. */
export interface PerMap<T> {
  fused: T;
  template: T;
  statistical: T;
}

// Generated from service/protocol by `make guide`; do not edit.

/** How a stream treats frames that arrive faster than they are tracked. */
export type Mode = "latest" | "lossless";
/** How a target stands in a frame. */
export type TargetStatus = "tracking" | "uncertain" | "lost";
/** A named configuration of the tracker. */
export type Preset = "default" | "paper";
/** What a frame of another size does to a session. */
export type Resize = "reject" | "rescale";
/** A format in which past results are written. */
export type TrajectoryFormat = "json" | "csv" | "otb" | "mot";
/** Why a session ended. */
export type EndReason = "closed" | "idle" | "expired" | "lost";
/** Why a call, a message or a handshake was refused. */
export type ProblemCode = "bad-request" | "unauthenticated" | "origin-refused" | "not-found" | "session-not-found"
  | "target-not-found" | "method-not-allowed" | "not-acceptable" | "attached-elsewhere" | "stale-frame"
  | "full-frame-needed" | "session-gone" | "elsewhere" | "host-refused" | "frame-too-large" | "body-too-large"
  | "unsupported-image" | "unsupported-media-type" | "frame-undecodable" | "frame-size-changed" | "bad-box"
  | "bad-region" | "bad-snapshot" | "too-many-targets" | "over-credit" | "rate-limited" | "over-quota" | "internal"
  | "at-capacity" | "draining" | "deadline-exceeded";
export type ImageType = "image/jpeg" | "image/png" | "image/webp";

/** The three tests of section III-C. */
export interface Flags {
  fused: boolean;
  template: boolean;
  statistical: boolean;
}

/** Each peak over its mean of the last 10 frames. */
export interface Scores {
  fused: number;
  template: number;
  statistical: number;
}

/** Where a target is and how far to trust it. */
export interface Target {
  /** Unique in the session; the first is 0. */
  id: number;
  /**
   * `[x, y, w, h]`: pixels of the whole frame after EXIF orientation, 0-based, top-left corner; the last known one
   * while lost.
   */
  box: Box;
  /**
   * `tracking`, `uncertain` or `lost` (not found for long enough; the search goes on): by the confidence, with the
   * preset `paper` by the three tests.
   */
  status: TargetStatus;
  /**
   * All three flags, and the status is `tracking`; null on the frame that started or corrected the target, as are
   * `flags`, `scores` and `psr`.
   */
  reliable: boolean | null;
  /** `{fused, template, statistical}`: the three tests of section III-C. */
  flags: Flags | null;
  /** `{fused, template, statistical}`: each peak over its mean of the last 10 frames. */
  scores: Scores | null;
  /** Peak-to-sidelobe ratio of the fused map, without 11×11 around the peak. */
  psr: number | null;
  /** Whether the models learned from this frame. */
  updated: boolean;
  /** Size relative to the box given. */
  scale: number;
  /**
   * Probability that the box overlaps the target by more than half: the number to act on; null only in results that an
   * older version kept.
   */
  confidence: number | null;
  /** Response maps as gray PNG, base64 in JSON, where `maps` was asked for. */
  maps?: Record<string, Bytes> | null;
}

/** Where the service spent its time, in milliseconds of the monotonic clock. */
export interface Timing {
  queue_ms: number;
  decode_ms: number;
  track_ms: number;
}

/** What the trackers found in one frame. */
export interface Result {
  type: "result";
  /** Number of a frame message. */
  seq: number;
  /** Echoed, never interpreted. */
  ts: number | string | null;
  size: Size;
  /** Frames superseded since the previous result. */
  dropped: number;
  /** `[x, y, w, h]` in whole pixels of the frame. */
  region: Region | null;
  targets: Target[];
  timing: Timing | null;
}

/** One tracked frame of the past. */
export interface PastResult {
  /** Number of a frame message. */
  seq: number;
  /** Echoed, never interpreted. */
  ts: number | string | null;
  size: Size;
  /** `[x, y, w, h]` in whole pixels of the frame. */
  region: Region | null;
  targets: Target[];
}

/** Where frames are streamed to. */
export interface StreamAddress {
  url: string;
  attached: boolean;
}

/** A session as it is now; `seq` is the last frame tracked. */
export interface SessionInfo {
  id: string;
  created_at: string;
  expires_at: string;
  label: string | null;
  preset: string;
  size: Size;
  /** Number of a frame message. */
  seq: number;
  /** `[x, y, w, h]` in whole pixels of the frame. */
  region: Region | null;
  targets: Target[];
  stream: StreamAddress;
}

/** The first message of the service, once. */
export interface Ready {
  type: "ready";
  session: SessionInfo;
  mode: Mode;
  /** Unanswered frames allowed; null in `latest`. */
  credit: number | null;
  /** Frames in flight that regions leave room for. */
  region_lag: number;
  /** The number that the next frame takes. */
  next_seq: number;
  /** Name of this attachment, for `resume`. */
  attachment: string;
  /**
   * After a breakdown of the service, until a frame is tracked: the last frame that the session knows; what it learned
   * from later ones is lost.
   */
  lost_after: number | null;
}

/** The targets after a control, or after a change over HTTP. */
export interface TargetsMessage {
  type: "targets";
  /** Echoed in the answer. */
  ref?: number | string;
  /** `[x, y, w, h]` in whole pixels of the frame. */
  region: Region | null;
  targets: Target[];
}

/** A target that was added or corrected, and the region that is needed from now on. */
export interface TargetChange {
  target: Target;
  /** `[x, y, w, h]` in whole pixels of the frame. */
  region: Region | null;
}

/** One handshake: offer the subprotocol `mfcmt.ticket.TICKET` beside the one you speak. */
export interface Ticket {
  ticket: string;
  expires_at: string;
}

/** What the service accepts. */
export interface Limits {
  max_frame_bytes: number;
  max_frame_pixels: number;
  max_frame_side_px: number;
  max_frame_scans: number;
  max_frame_scan_pixels: number;
  max_json_frame_bytes: number;
  max_body_bytes: number;
  max_snapshot_bytes: number;
  max_targets_per_session: number;
  max_sessions_per_key: number;
  max_streams_per_key: number;
  max_trajectory_bytes: number;
  idle_timeout_s: number;
  max_idle_timeout_s: number;
  attached_idle_timeout_s: number;
  max_session_s: number;
  operation_deadline_s: number;
  credit_frames: number;
  region_lag_frames: number;
  max_messages_per_s: number;
  max_requests_per_s: number;
  max_frames_per_s_per_key: number;
  max_frame_bytes_per_s_per_key: number;
  ticket_s: number;
  max_ticket_s: number;
}

/** What this service can do. */
export interface Capabilities {
  /** Version of the wire protocol. */
  protocol: number;
  subprotocols: string[];
  modes: string[];
  presets: string[];
  image_types: string[];
  trajectory_formats: string[];
  snapshot_versions: number[];
  limits: Limits;
  software: Record<string, string>;
}

/** An RFC 9457 problem, with the code that programs decide by. */
export interface ProblemDocument {
  type: string;
  title: string;
  status: number;
  detail: string;
  code: string;
  /** Seconds after which trying again makes sense. */
  retry_after_s?: number;
  /** How a session ended. */
  reason?: string;
  /** What a region must cover. */
  region?: Region | null;
  /** Finds a fault of the service in its log. */
  request_id?: string;
  /** Where another node has what was asked for. */
  url?: string;
  [member: string]: unknown;
}

/** How a session tracks and how long it waits. */
export interface SessionOptions {
  /** Configuration of the tracker: `default` or `paper`. */
  preset?: Preset;
  /** Seconds without a frame or call after which the session ends. */
  idle_timeout_s?: number;
  /** What a frame of another size does to the session: `reject` or `rescale`. */
  on_resize?: Resize;
  /** Echoed; at most 200 characters. */
  label?: string;
  /** Response maps in every result. */
  maps?: boolean;
}
// End of the generated part

/** An encoded still image. */
export type Encoded = Instance<"Blob"> | ArrayBuffer | ArrayBufferView;
/** Pixels that the client encodes (browsers only). */
export type Pixels = Instance<
  "HTMLVideoElement" | "HTMLImageElement" | "HTMLCanvasElement" | "OffscreenCanvas" | "ImageBitmap" | "ImageData" | "VideoFrame"
>;
export type Source = Encoded | Pixels;

/**
 * Every error that this client throws on purpose. `code` is one of the protocol's problems (with the status 0 where the client
 * itself refused what it was given), or of the client's own:
 * `connection-lost` (the server cannot be reached, or not again in time), `stream-ended` (used after its end),
 * `unsupported-source` (not a frame, or pixels where nothing can encode them), `aborted`, `no-websocket`.
 */
export class MFCMTError extends Error {
  constructor(problem: Partial<ProblemDocument>, context?: { seq?: number | null; ref?: unknown; cause?: unknown });
  readonly code: ProblemCode | "connection-lost" | "stream-ended" | "unsupported-source" | "aborted" | "no-websocket" | (string & {});
  readonly type: string;
  /** HTTP status; 0 where there was no answer. */
  readonly status: number;
  readonly title: string;
  readonly detail: string;
  /** Seconds after which trying again makes sense. */
  readonly retryAfter: number | null;
  /** How a session ended: `closed`, `idle`, `expired`, `lost`. */
  readonly reason: string | null;
  /** What a region must cover. */
  readonly region: Region | null;
  readonly requestId: string | null;
  /** The stream's frame message that was refused. */
  readonly seq: number | null;
  readonly ref: unknown;
  readonly problem: ProblemDocument;
}

export interface ClientOptions {
  /**
   * Base URL of the service, `http:` or `https:`, perhaps with a path; in a page its own origin by default and may be
   * relative, else `http://127.0.0.1:8000`.
   */
  url?: string;
  /** An API key. Streams then fetch a ticket for every handshake: keys never appear in a URL. */
  key?: string;
  fetch?: (url: string, init?: any) => Promise<any>;
  /** A WebSocket class; needed in Node 20 (npm `ws`), there from the start in browsers, React Native and Node 22. */
  WebSocket?: new (url: string, protocols?: string[]) => unknown;
  /** Limit of one HTTP call or handshake. Default 30,000. */
  timeoutMs?: number;
  /** For streams with the codec `msgpack`: a library such as `@msgpack/msgpack`. */
  msgpack?: { encode(value: unknown): Uint8Array; decode(bytes: ArrayBuffer): unknown };
  /**
   * Where the worker that encodes pixels is served, built from `@mfcmt/client/worker`. Needed only where the page's
   * Content-Security-Policy forbids `blob:` and the bundler leaves the worker's file behind (esbuild).
   */
  workerUrl?: string | Instance<"URL">;
  /**
   * What boxes, regions and sizes are pixels of, those given and those told: the frames as they are sent (`sent`, the
   * default), or the video, canvas or image that they were made from (`source`), whatever `maxSide` made of it.
   * An encoded image is its own source. Trajectories as text, and `Stream.info`, are always in pixels as sent.
   */
  boxesIn?: "sent" | "source";
}

/** How pixels become an image. */
export interface EncodeOptions {
  /** Default 0.8. */
  quality?: number;
  /** Default `image/jpeg`. */
  imageType?: ImageType;
  /** The longest side of the frame as it is sent; larger ones are scaled down. */
  maxSide?: number;
}

export interface CreateOptions extends EncodeOptions {
  /**
   * The first frame. Unless `boxesIn` is `source`, boxes are in its pixels as it is sent: `fittedSize` tells its size
   * where `maxSide` scales it.
   */
  frame: Source;
  box?: Box | number[];
  boxes?: (Box | number[])[];
  options?: SessionOptions;
  /** Repeating the call with the same key and body gives the same session. Random by default. */
  idempotencyKey?: string;
  signal?: Signal;
  /** How long to ask again while the service has no ready lane or no place. Default 30,000. */
  waitMs?: number;
  /** End the session when the page is left or reloaded. By default true in a page. */
  endWithPage?: boolean;
}

export interface StreamOptions extends EncodeOptions {
  /** `latest` (default) drops what newer frames overtake; `lossless` answers every frame. */
  mode?: Mode;
  /** Default `json`. */
  codec?: Codec;
  /** Send only what the trackers need; `auto` (default) does so on mobile devices and when data is to be saved. */
  regions?: "auto" | boolean;
  /** Where pixels are encoded: `auto` (default) in a worker if the browser can, else on the main thread. */
  encoder?: "auto" | "worker" | "main";
  /** Frames to send, all of them; the stream finishes by itself afterwards. */
  frames?: Iterable<Source> | AsyncIterable<Source>;
  /** End another attachment of the session on attaching. Reconnecting never does. */
  takeover?: boolean;
  /** A ticket, or a function that returns one for each handshake: for pages that hold no key. */
  ticket?: string | (() => string | Promise<string>);
  /** How long a broken connection is tried again, also while others stand in for the service. Default 60,000. */
  reconnectForMs?: number;
  /** A connection that is silent for this long while frames are unanswered counts as broken. Default 10,000. */
  stallMs?: number;
  signal?: Signal;
}

export interface SendOptions {
  /** Echoed in the result. */
  ts?: number | string;
  /** An encoded image shows only this part of the frame. */
  region?: Region;
  /** The frame's number; the next one by default. */
  seq?: number;
  /** The stream may consume the ImageBitmap or VideoFrame and closes it, instead of taking a copy. */
  transfer?: boolean;
  /** Send the whole frame even where a region would do. */
  whole?: boolean;
}

export type StreamStatus = "connecting" | "open" | "resuming" | "draining" | "closed";

export interface StreamStats {
  /** Frames handed to the socket. */
  sent: number;
  /** Results received. */
  answered: number;
  /** Superseded on the server by newer frames (`latest`). */
  dropped: number;
  /** Not sent because the stream was busy, paused or not connected (`latest`). */
  skipped: number;
  refused: number;
  /** Frames sent or waiting to be, without an answer yet. */
  inFlight: number;
  /** Of images only. */
  bytesSent: number;
  /** By regions; estimated from whole frames that are encoded now and then for comparison. */
  bytesSaved: number;
  /** From `send` to the result, of the last frame and over the last 120; null before the first. */
  latencyMs: number | null;
  latencyP50Ms: number | null;
  latencyP95Ms: number | null;
  /** Results a second, over the last two. */
  rate: number;
  /** Capturing and encoding the last frame. */
  encodeMs: number | null;
  reconnects: number;
}

export interface StatusChange {
  status: StreamStatus;
  previous: StreamStatus;
  /** While `resuming` or `connecting`: why the last attempt failed; on `closed`: what ended the stream, if not its user. */
  error: MFCMTError | null;
  /** When the next attempt is made, from now. */
  retryInMs: number | null;
}

/** A stream goes on after its connection broke. */
export interface Resumed {
  /** The last frame that the session knows. */
  seq: number;
  /** How long the stream was interrupted. */
  downMs: number;
  /**
   * Null when nothing is lost. Else the service broke down: results above this number stand, but the trackers have
   * forgotten what they learned from those frames.
   */
  lostAfter: number | null;
}

export interface StreamEvents {
  result: Result;
  status: StatusChange;
  resumed: Resumed;
  /** A frame was refused; the stream goes on. */
  problem: MFCMTError;
  /** The targets after a control or a change over HTTP. */
  targets: TargetsMessage;
  /** Another frame may be sent. */
  ready: undefined;
}

/** One attachment of a session that outlives its connections. It connects as soon as it is made. */
export class Stream {
  readonly status: StreamStatus;
  readonly mode: Mode;
  readonly codec: Codec;
  /** Whether only needed parts of pixels are sent; may be set at any time. */
  regions: boolean;
  /** JPEG quality and scaling of the coming frames; may be set at any time. */
  quality: number;
  maxSide: number | null;
  /** Where pixels are encoded; null until the first are. */
  readonly encoder: "worker" | "main" | null;
  /** What the service said on attaching; null before. */
  readonly info: Ready | null;
  /** The session's frame; null before the stream is attached. */
  readonly size: Size | null;
  /** The targets as the service said last. */
  readonly targets: Target[];
  /** The part of the coming frames that is needed; null for none. */
  readonly region: Region | null;
  /** Whether a frame would be taken now. */
  readonly canSend: boolean;
  /** Resolves when a frame would be taken. Rejects when the stream has ended. */
  readonly ready: Promise<void>;
  /** Resolves when the stream has ended; rejects with the error that ended it, if its user did not. */
  readonly closed: Promise<void>;
  readonly paused: boolean;
  /** The counters now (a copy). */
  readonly stats: StreamStats;
  /**
   * Results in order; ends with the stream and throws what ended it. Iterate once; events and iteration may be
   * used together. While many wait unread, `canSend` is false. Leaving a `for await` early closes the stream, and the
   * session is free when the loop is left; calling `next()` closes nothing.
   */
  readonly results: AsyncIterableIterator<Result>;
  /** The same as `results`. */
  [Symbol.asyncIterator](): AsyncIterableIterator<Result>;

  /**
   * Send the frame that the source shows now. `latest`: a frame that cannot be taken now is skipped. `lossless`:
   * waits for room. Resolves when it is handed to the socket, with its number, or with null if it was skipped.
   * Rejects for a bad source or an ended stream; what the server refuses is an event `problem`.
   */
  send(source: Source, options?: SendOptions): Promise<number | null>;
  /** Send each frame that a playing video shows, at most `fps` a second, until the function returned is called. */
  follow(video: Instance<"HTMLVideoElement">, options?: { fps?: number }): () => void;
  /** Start another target on the newest frame, or (`onNext`) on the next one sent. */
  add(box: Box | number[], options?: { onNext?: boolean }): Promise<TargetsMessage>;
  /** Put a target right on the newest frame, or (`onNext`) on the next one sent. */
  correct(target: number, box: Box | number[], options?: { onNext?: boolean }): Promise<TargetsMessage>;
  remove(target: number): Promise<TargetsMessage>;
  /** Take no frames for now: in `latest` they are skipped, in `lossless` they wait. */
  pause(): void;
  resume(): void;
  /** No more frames will come: resolves when all are answered and the stream has closed. */
  finish(): Promise<void>;
  /** End the attachment now; the session lives on. */
  close(): void;
  /** Listen; returns the function that stops it. */
  on<K extends keyof StreamEvents>(event: K, listener: (detail: StreamEvents[K]) => void): () => void;
}

export class Session {
  readonly id: string;
  /** The session as the service described it last. */
  readonly info: SessionInfo;
  refresh(): Promise<SessionInfo>;
  /** End the session. */
  close(): Promise<void>;
  /** One frame over HTTP; streams are faster. */
  track(frame: Source, options?: EncodeOptions & Pick<SendOptions, "ts" | "region" | "seq">): Promise<Result>;
  addTarget(box: Box | number[]): Promise<TargetChange>;
  correctTarget(target: number, box: Box | number[]): Promise<TargetChange>;
  removeTarget(target: number): Promise<void>;
  /** All results so far, or those after a `seq`. */
  trajectory(options?: { format?: "json"; after?: number; target?: number }): Promise<PastResult[]>;
  trajectory(options: { format: Exclude<TrajectoryFormat, "json">; after?: number; target?: number }): Promise<string>;
  /** The session's whole state, for `Client.restoreSession`. */
  snapshot(): Promise<Bytes>;
  /** Admits one handshake of this session within `ttlS` seconds. */
  ticket(ttlS?: number): Promise<Ticket>;
  stream(options?: StreamOptions): Stream;
}

export class Client {
  constructor(options?: ClientOptions);
  readonly url: string;
  /** What boxes, regions and sizes are pixels of. */
  readonly boxesIn: "sent" | "source";
  createSession(options: CreateOptions): Promise<Session>;
  /** Start a session where the one of the snapshot was. */
  restoreSession(snapshot: Encoded, options?: { signal?: Signal; waitMs?: number }): Promise<Session>;
  getSession(id: string): Promise<Session>;
  deleteSession(id: string): Promise<void>;
  /** The caller's own sessions, page by page. */
  sessions(): AsyncIterableIterator<SessionInfo>;
  ticket(id: string, ttlS?: number): Promise<Ticket>;
  /** Limits, presets, image types, versions. */
  capabilities(): Promise<Capabilities>;
  /** Attach to a session known by its id alone: with `ticket`, no key is needed. */
  stream(id: string, options?: StreamOptions): Stream;
}

/** The image of a frame as a session or stream would send it, its size, and the size of its source. */
export function encodeFrame(
  source: Pixels,
  options?: EncodeOptions & { region?: Region },
): Promise<{ blob: Instance<"Blob">; size: Size; sourceSize: Size }>;
/** The size of a `width`×`height` frame when its longer side may be `maxSide` at most. */
export function fittedSize(width: number, height: number, maxSide?: number | null): Size;
/** Whether `regions: "auto"` sends regions here: on a mobile device, or in a browser that is to save data. */
export function regionsByDefault(): boolean;
/** The version of this client. */
export const VERSION: string;
