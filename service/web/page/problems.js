// Explains problems to the user, and says what to do about them.

/** Title, text and `action` of each code. trouble.js knows the actions `key`, `again` and `restart`. */
const WORDS = {
  "camera-refused": ["Camera access was refused", "Allow the camera for this page in the browser's address bar, then try again.", "again"],
  "camera-missing": ["No camera was found", "Connect one, or choose a video file.", "again"],
  "camera-busy": ["The camera is in use", "Another program or tab holds it. Close that, then try again.", "again"],
  "camera-insecure": ["Cameras need a secure page", "Browsers give them to https pages and to localhost only. Open the page through https."],
  "camera-failed": ["The camera did not start", "Unplug it and plug it in again, or choose another one in the settings.", "again"],
  "camera-ended": ["The camera stopped", "It was unplugged or taken away from this page.", "again"],
  "screen-missing": ["This browser does not show its screen to pages", "Use a browser on a computer, and open the page through https."],
  "screen-refused": ["The screen was not given", "Choose a screen, a window or a tab, and allow it.", "again"],
  "screen-ended": ["The screen is no longer shown", "It was taken away from this page.", "again"],
  "video-unreadable": ["This video cannot be played here", "The browser does not know its format. MP4 (H.264) and WebM work almost everywhere. `mfcmt track FILE` reads most others, or convert it: ffmpeg -i FILE -c:v libx264 out.mp4"],
  "video-broken": ["This video is damaged here", "The browser cannot decode the next frame. What was tracked stays."],
  "images-missing": ["No images were found", "Choose JPEG, PNG or WebP images, or a folder or zip file of them."],
  "image-unreadable": ["An image cannot be read", "It is damaged, or no image."],
  "zip-unreadable": ["This zip file cannot be read", "It is damaged, encrypted, or of a kind that the page does not know."],
  "zip-too-large": ["This zip file is too large for the page", "Unpack it, and choose the folder."],
  "import-unreadable": ["This file cannot be imported", "It must be a run that this page exported as JSON, or lines of MOT (frame,id,x,y,w,h,…) or OTB (x,y,w,h), of the video that is open."],
  "no-encoder": ["This browser cannot make a video", "Browsers encode on pages of https and localhost only. Record shows the same, in real time."],
  "address-unreachable": ["The address cannot be opened", "The page may load only from its own server. Save the file, and choose it here."],
  "sample-missing": ["The sample clip could not be loaded", "The server did not answer. Is it still running?", "again"],
  "at-capacity": ["The server is full", "All its places are taken.", "again"],
  draining: ["The server is restarting", "Try again in a moment.", "again"],
  unauthenticated: ["A key is needed", "This server asks for an API key.", "key"],
  "origin-refused": ["This address is not allowed", "The server refuses calls from pages of this address."],
  "host-refused": ["The server does not accept this host name", "Without keys it answers only to its IP address, localhost and the names in its settings."],
  "session-not-found": ["The session is gone", "The server does not know it. It may have been restarted.", "restart"],
  "session-gone": ["The session expired", "The server ended it.", "restart"],
  "attached-elsewhere": ["The session was taken over", "Another page or client is attached to it now.", "restart"],
  "connection-lost": ["The server cannot be reached", "Check the network, or whether the server still runs.", "again"],
  "rate-limited": ["Too many frames", "The server accepts fewer frames per second from this key.", "restart"],
  "over-quota": ["The quota of this key is used up", "Close one of its sessions or streams, then try again.", "again"],
  "bad-box": ["This box cannot be followed", "It is too small, or too much of it is outside the picture. Draw another one."],
  "too-many-targets": ["No room for another target", "Remove one first."],
  "frame-too-large": ["The frames are too large", "Choose a smaller frame size in the settings.", "restart"],
  "frame-size-changed": ["The size of the picture changed", "The new size needs a new session.", "restart"],
  "deadline-exceeded": ["The server took too long", "It may be overloaded.", "restart"],
  internal: ["The server had an internal error", "It is in the server's log.", "restart"],
};
const REASONS = {
  idle: "No frame came for too long, so the server ended it.",
  expired: "It reached the greatest age that the server allows.",
  lost: "The server lost it because of an error.",
  closed: "Another client closed it.",
};
const LABELS = { again: "Try again", key: "Enter key", restart: "Go on from here" };

/** Returns `{title, text, action, label}` for any error. */
export function explain(error) {
  const known = WORDS[error.code];
  if (!known) return { title: "Something went wrong", text: error.detail ?? error.message ?? String(error), action: "restart", label: LABELS.restart };
  let [title, text, action] = known;
  if (error.reason && REASONS[error.reason]) text = REASONS[error.reason];
  if (error.retryAfter && action === "again") text += ` Try again in ${Math.ceil(error.retryAfter)} s.`;
  if (error.code === "internal" && error.requestId) text += ` Request ${error.requestId}.`;
  return { title, text, action, label: LABELS[action] };
}
