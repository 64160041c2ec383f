// Type-checked, never run: what people write in Node and React Native, where there is no DOM.
import { Client, MFCMTError, type Bytes, type Pixels } from "@mfcmt/client";
import { letterbox } from "@mfcmt/client/view";

export async function node(frames: AsyncIterable<Uint8Array>, WebSocket: new (url: string, protocols?: string[]) => object): Promise<string> {
  const client = new Client({ url: "http://127.0.0.1:8000", WebSocket });
  try {
    const session = await client.getSession("id");
    const past = await session.trajectory({ after: 3 });
    const told: number[] = [past[0]?.targets[0]?.scores?.fused ?? 0];
    for await (const { timing } of session.stream({ frames, mode: "lossless" })) told.push(timing?.track_ms ?? 0);
    const restored = await client.restoreSession(await session.snapshot());
    await client.deleteSession(restored.id);
    return await session.trajectory({ format: "csv" });
  } catch (error) {
    if (error instanceof MFCMTError && error.code === "at-capacity") return `again in ${error.retryAfter} s`;
    throw error;
  }
}

// @ts-expect-error: this project has no DOM, and the client's types must not bring it
export type Nothing = HTMLVideoElement;
// Without a DOM nothing is pixels, so nothing but encoded images is a frame.
export const none: [Pixels] extends [never] ? true : false = true;
export const map: Bytes | undefined = undefined;
export const { area } = letterbox([4, 3], [1, 1]);
