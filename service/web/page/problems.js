// What went wrong, in words of whoever uses the page, and what can be done about it.

/** `action` is a word that main.js knows: `key`, `again`, `restart`, `camera`, or none. */
const WORDS = {
  "camera-refused": ["Camera access was refused", "Allow the camera for this page in the browser's address bar, then try again.", "again"],
  "camera-missing": ["No camera was found", "Connect one, or choose a video file.", "again"],
  "camera-busy": ["The camera is in use", "Another program or tab holds it. Close that, then try again.", "again"],
  "camera-insecure": ["Cameras need a secure page", "Browsers give them to https pages and to localhost only. Open the page through https."],
  "camera-failed": ["The camera did not start", "Unplug it and plug it in again, or choose another one in the settings.", "again"],
  "camera-ended": ["The camera stopped", "It was unplugged or taken away from this page.", "again"],
  "video-unreadable": ["This video cannot be played here", "The browser does not know its format. MP4 (H.264) and WebM work almost everywhere."],
  "sample-missing": ["The sample clip could not be loaded", "The server did not answer. Is it still running?", "again"],
  "at-capacity": ["The server is full", "All its places are taken.", "again"],
  draining: ["The server is going away", "It is being restarted. Try again in a moment.", "again"],
  unauthenticated: ["A key is needed", "This server asks for an API key.", "key"],
  "origin-refused": ["This address is not allowed", "The server does not take calls from pages of this address."],
  "host-refused": ["This name is not the server's", "Without a key it answers to its IP address, localhost and names in its settings alone."],
  "session-not-found": ["The session is gone", "The server does not know it any more; it may have been restarted.", "restart"],
  "session-gone": ["The session expired", "The server ended it.", "restart"],
  "attached-elsewhere": ["The session was taken over", "Another page follows it now.", "restart"],
  "connection-lost": ["The server cannot be reached", "Check the network, or whether the server still runs.", "restart"],
  "rate-limited": ["Too many frames", "The server takes fewer a second from this key.", "restart"],
  "over-quota": ["This key has as much as it may have", "Close a session or a stream of it, then try again.", "again"],
  "bad-box": ["This box cannot be followed", "It is too small, or too much of it lies outside of the picture. Draw another."],
  "too-many-targets": ["No room for another target", "Remove one first."],
  "frame-too-large": ["The frames are too large", "Choose a smaller frame size in the settings.", "restart"],
  "frame-size-changed": ["The picture changed its size", "A new session is needed for it.", "restart"],
  "deadline-exceeded": ["The server took too long", "It may be overloaded.", "restart"],
  internal: ["The server had a fault", "It was logged there.", "restart"],
};
const REASONS = {
  idle: "No frame came for too long, so the server ended it.",
  expired: "It reached the longest time that the server allows.",
  lost: "The server lost it in a fault.",
  closed: "It was closed from elsewhere.",
};
const LABELS = { again: "Try again", key: "Enter key", restart: "Go on from here" };

/** `{title, text, action, label}` for anything that was thrown. */
export function explain(error) {
  const known = WORDS[error.code];
  if (!known) return { title: "Something went wrong", text: error.detail ?? error.message ?? String(error), action: "restart", label: LABELS.restart };
  let [title, text, action] = known;
  if (error.reason && REASONS[error.reason]) text = REASONS[error.reason];
  if (error.retryAfter && action === "again") text += ` Try again in ${Math.ceil(error.retryAfter)} s.`;
  if (error.code === "internal" && error.requestId) text += ` Request ${error.requestId}.`;
  return { title, text, action, label: LABELS[action] };
}
