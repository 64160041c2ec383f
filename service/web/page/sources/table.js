// Which frames a video file has, and when each is shown, as the file itself says.

/** The library that reads and writes video files; it is loaded when the first file is opened. */
export const library = () => import("../vendor/mediabunny/mediabunny.min.mjs");

/**
 * Read a video file's table: `{track, times, duration, fps, size}`; times are in seconds, in the order of presentation.
 * Resolves to null for a file that cannot be read, or has no video.
 */
export async function readTable(blob) {
  let input = null;
  try {
    const { ALL_FORMATS, BlobSource, EncodedPacketSink, Input } = await library();
    input = new Input({ source: new BlobSource(blob), formats: ALL_FORMATS });
    const track = await input.getPrimaryVideoTrack();
    if (!track) return null;
    const spans = [];
    const packets = new EncodedPacketSink(track).packets(undefined, undefined, { metadataOnly: true });
    for await (const { timestamp, duration } of packets) spans.push([timestamp, duration]);
    return spans.length ? { input, track, ...tableOf(spans), size: await sizeOf(track) } : null;
  } catch {
    input?.dispose();
    return null; // the browser may know the format
  }
}

/** Make times, duration and rate of the packets' times and durations, which come in the order of decoding. */
function tableOf(packets) {
  const spans = packets.sort(([a], [b]) => a - b);
  const shown = spans.filter(([time, lasts], i) => time + lasts > 1e-6 && time !== spans[i - 1]?.[0]); // not cut off by an edit list
  const times = (shown.length ? shown : spans).map(([time]) => time);
  const [last, lasts] = spans.at(-1);
  const usual = times.length > 1 ? (last - times[0]) / (times.length - 1) : lasts || 1 / 30;
  return { times, duration: last + (lasts || usual), fps: 1 / usual };
}

async function sizeOf(track) {
  return [await track.getDisplayWidth(), await track.getDisplayHeight()];
}
