// Type-checked, never run: a session with the types that openapi-typescript makes, and what they must refuse.
import type { components, operations, paths } from "./api.js";

type Schemas = components["schemas"];
type Answer<Name extends keyof operations, Status extends keyof operations[Name]["responses"]> =
  operations[Name]["responses"][Status] extends { content: { "application/json": infer Told } } ? Told : never;

async function call<Told>(method: string, path: keyof paths, body?: unknown): Promise<Told> {
  const response = await fetch(path, { method, body: JSON.stringify(body) });
  if (response.ok) return (await response.json()) as Told;
  const problem = (await response.json()) as Schemas["Problem"];
  throw new Error(`${problem.code}: ${problem.detail}, again in ${problem.retry_after_s ?? 0} s`);
}

export async function session(frame: string): Promise<[number, number, number, number] | undefined> {
  const body: NonNullable<operations["create_session"]["requestBody"]>["content"]["application/json"] = {
    frame,
    box: [198, 214, 34, 81],
    options: { preset: "default", on_resize: "reject", maps: false, idle_timeout_s: 60 },
  };
  const made = await call<Answer<"create_session", 201>>("POST", "/v1/sessions", body);
  const result = await call<Answer<"post_frame", 200>>("POST", "/v1/sessions/{session_id}/frames", { frame, seq: 1 });
  const change = await call<Answer<"add_target", 201>>("POST", "/v1/sessions/{session_id}/targets", { box: body.box });
  const past = await call<Answer<"get_trajectory", 200>>("GET", "/v1/sessions/{session_id}/trajectory");
  const status: "tracking" | "uncertain" | "lost" | undefined = result.targets[0]?.status;
  console.log(made.stream.url, status, change.target.scores?.fused, past.results[0]?.ts);
  return result.targets[0]?.box;
}

// @ts-expect-error: there is no such call
export type NoCall = operations["make_session"];
// @ts-expect-error: a box is four numbers
export const box: Schemas["BoxBody"] = { box: [1, 2, 3] };
// @ts-expect-error: a frame is needed
export const none: Schemas["CreateBody"] = { box: [1, 2, 3, 4] };
