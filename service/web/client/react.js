/** A React hook that follows boxes through a video, and an overlay that shows them. See README.md. */

import { createElement, useCallback, useEffect, useMemo, useRef, useState } from "react";
import { Run } from "./lib/run.js";
import { drawBoxes, overlay } from "./view.js";

const NO_RUN = new Run(() => {});
const IDLE = { status: "idle", targets: [], size: null, error: null };

/**
 * Return the state of a run, `{status, targets, size, error}`, and what can be done with it. The run ends with the
 * component. `options` has `session` (for `createSession`), `stream` (for `session.stream`) and `fps`.
 */
export function useTracker(client, options = {}) {
  const [state, setState] = useState(IDLE);
  const run = useRef(null);
  const newest = useRef(options);
  useEffect(() => {
    newest.current = options;
  });

  const stop = useCallback(() => {
    run.current?.end();
    run.current = null;
    setState(IDLE);
  }, []);
  const start = useCallback(
    async (source, ...boxes) => {
      run.current?.end();
      const own = new Run((change) => run.current === own && setState((before) => ({ ...before, ...change })));
      run.current = own;
      setState({ ...IDLE, status: "starting" });
      await own.start(client, source, boxes, newest.current);
    },
    [client],
  );
  useEffect(
    () => () => {
      run.current?.end();
      run.current = null;
    },
    [client],
  );
  const actions = useMemo(() => {
    const stream = () => (run.current ?? NO_RUN).running();
    return {
      start,
      stop,
      add: async (box) => stream().add(box),
      correct: async (target, box) => stream().correct(target, box),
      remove: async (target) => stream().remove(target),
      send: async (frame, how) => stream().send(frame, how),
    };
  }, [start, stop]);
  return { ...state, ...actions, stream: run.current?.stream ?? null };
}

/**
 * Show boxes over the element of the ref `of`, which must be a sibling in a positioned element. With `onBox` the user can
 * draw boxes on it. `label(target)` returns a text for a target.
 */
export function Overlay({ of, targets = [], size = null, onBox = null, label, ...attributes }) {
  const svg = useRef(null);
  const layer = useRef(null);
  const newest = useRef({ onBox, label });
  useEffect(() => {
    newest.current = { onBox, label };
  });
  useEffect(() => {
    const options = { svg: svg.current, label: (target) => newest.current.label?.(target) ?? "" };
    layer.current = overlay(of.current, options);
    return () => layer.current.remove();
  }, [of]);
  useEffect(() => layer.current.draw(targets, size), [of, targets, size]);
  const draws = onBox !== null;
  useEffect(() => {
    if (!draws) return undefined;
    return drawBoxes(of.current, (box) => newest.current.onBox?.(box), { onDraft: (box) => layer.current.draft(box) });
  }, [of, draws]);
  return createElement("svg", { "aria-hidden": true, ...attributes, ref: svg });
}
