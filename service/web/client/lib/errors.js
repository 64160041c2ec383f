/** The errors of the client. */

export class MFCMTError extends Error {
  constructor(problem, { seq = null, ref = null, cause } = {}) {
    const code = String(problem.code ?? "internal");
    const detail = String(problem.detail ?? problem.title ?? "");
    super(detail ? `${code}: ${detail}` : code, { cause });
    this.name = "MFCMTError";
    this.code = code;
    this.type = problem.type ?? "about:blank";
    this.status = problem.status ?? 0;
    this.title = problem.title ?? code;
    this.detail = detail;
    this.retryAfter = problem.retry_after_s ?? null;
    this.reason = problem.reason ?? null;
    this.region = problem.region ?? null;
    this.requestId = problem.request_id ?? null;
    this.seq = seq;
    this.ref = ref;
    this.problem = { ...problem, code, detail };
  }
}

export const wrong = (detail) => new MFCMTError({ code: "bad-request", detail });
export const connectionLost = (detail, cause) => new MFCMTError({ code: "connection-lost", detail }, { cause });
export const streamEnded = () => new MFCMTError({ code: "stream-ended", detail: "the stream has ended" });
export const unsupportedSource = (detail, cause) => new MFCMTError({ code: "unsupported-source", detail }, { cause });
export const aborted = (cause) => new MFCMTError({ code: "aborted", detail: "aborted by its signal" }, { cause });

/** The error of a page whose origin the service does not allow: browsers hide the service's own answer from it. */
export const originRefused = (url, origin, cause) =>
  new MFCMTError(
    {
      code: "origin-refused",
      status: 403,
      detail:
        `${url} answers, but not to pages of ${origin}: add this origin to MFCMT_ALLOWED_ORIGINS of the service ` +
        "(MFCMT_ALLOWED_ORIGINS=localhost allows every page of localhost, for development)",
    },
    { cause },
  );

/**
 * Whether the same attempt may succeed later. While the process that has a session is away, whatever stands in for it
 * says 404, 502 or 503: another replica does not know the session, and a proxy reaches nobody. `known`: the session
 * existed, and may exist again.
 */
export const mayPass = ({ code, status }, known) =>
  code === "connection-lost" || code === "rate-limited" || status >= 500 || (known && status === 404);

const BY_CLOSE_CODE = {
  1000: { code: "session-gone", status: 410, reason: "closed" },
  1009: { code: "frame-too-large", status: 413 },
  4400: { code: "bad-request", status: 400 },
  4401: { code: "unauthenticated", status: 401 },
  4403: { code: "origin-refused", status: 403 },
  4404: { code: "session-not-found", status: 404 },
  4408: { code: "session-gone", status: 410, reason: "idle" },
  4409: { code: "attached-elsewhere", status: 409 },
  4410: { code: "session-gone", status: 410 },
  4429: { code: "rate-limited", status: 429 },
};

/** Return what the service meant by closing a stream with this code. */
export function ofClose(code, reason) {
  const known = BY_CLOSE_CODE[code];
  if (!known) return connectionLost(`the stream broke off (${code}${reason ? ` ${reason}` : ""})`);
  return new MFCMTError({ ...known, title: known.code, detail: reason || `closed with ${code}` });
}

const BY_STATUS = {
  400: "bad-request",
  401: "unauthenticated",
  403: "origin-refused",
  404: "session-not-found",
  409: "attached-elsewhere",
  410: "session-gone",
  421: "host-refused",
  429: "rate-limited",
  503: "at-capacity",
};

/** Return what a refused handshake meant, where the WebSocket shows its HTTP status (npm `ws`); null elsewhere. */
export function ofHandshake(message) {
  const status = Number(/response: (\d{3})$/.exec(message ?? "")?.[1]);
  if (!status) return null;
  return new MFCMTError({ code: BY_STATUS[status] ?? "internal", status, detail: `the handshake got HTTP ${status}` });
}

/** Resolves with the problem in an HTTP answer; for any other body with its status alone. */
export async function ofResponse(response) {
  let problem = {};
  try {
    problem = await response.json();
  } catch {
    // no JSON: a proxy's page, for example
  }
  if (typeof problem?.code !== "string") problem = { code: "internal", detail: `HTTP ${response.status}` };
  const retryAfter = Number(response.headers.get("Retry-After") ?? NaN);
  if (problem.retry_after_s === undefined && Number.isFinite(retryAfter)) problem.retry_after_s = retryAfter;
  return new MFCMTError({ status: response.status, ...problem });
}
