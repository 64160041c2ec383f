#!/bin/bash
# Builds the image from the Dockerfile as it is, without Docker and without a registry, and runs it sealed:
# sudo docker/build_check.sh       # about five minutes the first time; the base image is kept for the next
# The base image is made by debootstrap and bears the name that the Dockerfile asks for, buildah builds, podman runs
# the container as its user on a read-only root, a client makes a session, and SIGTERM ends it. Size, time until ready
# and time of the first frame are printed. Debian packages: buildah podman runc debootstrap curl.
# pip in the build asks the index that pip is configured for here, debootstrap the mirror of apt.
set -euo pipefail
cd "$(dirname "$0")/.."
SUITE=bookworm MIRROR=$(.ci/mirror) MOST_MB=500
base=$(sed -n 's/^FROM \(python:[^ ]*\) AS base$/\1/p' docker/Dockerfile)
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
cache=${XDG_CACHE_HOME:-/var/tmp}/mfcmt-image-base
image=localhost/mfcmt:$version

die() { echo "build_check: $*" >&2 && exit 1; }
[ "$(id -u)" = 0 ] || die "run it as root: debootstrap and the build change users"
for tool in buildah podman runc debootstrap curl; do
    command -v "$tool" >/dev/null || die "$tool is missing: apt-get install buildah podman runc debootstrap curl"
done

# Images and containers of this run alone.
work=$(mktemp -d /var/tmp/mfcmt-image.XXXXXX)
export STORAGE_DRIVER=overlay BUILDAH_ISOLATION=chroot TMPDIR="$work/tmp"
mkdir "$TMPDIR"
store=(--root "$work/storage" --runroot "$work/run")
# Without overlays layers are copied: slower, and the same.
command podman "${store[@]}" info >/dev/null 2>&1 || export STORAGE_DRIVER=vfs
podman() { command podman "${store[@]}" --runtime runc --cgroup-manager cgroupfs "$@"; }
container=""
tidy() {
    [ -z "$container" ] || podman rm --force --time 0 "$container" >/dev/null 2>&1 || true
    podman unmount --all >/dev/null 2>&1 || true
    rm -rf "$work"
}
trap tidy EXIT

# The base image: Debian's minimal system with its own Python 3.11 and pip where the real one has them.
if ! [ -f "$cache/$SUITE.tar" ]; then
    echo "== making a base image with debootstrap"
    debootstrap --variant=minbase --include=python3,python3-pip,ca-certificates "$SUITE" "$work/base" "$MIRROR" \
        >"$work/debootstrap.log" || die "debootstrap failed: $(tail -3 "$work/debootstrap.log")"
    ln -s /usr/bin/python3 "$work/base/usr/local/bin/python3"
    rm -rf "$work"/base/var/cache/apt/* "$work"/base/var/lib/apt/lists/* \
        "$work"/base/usr/share/{doc,man,locale,info}
    mkdir -p "$cache"
    tar -C "$work/base" -cf "$cache/$SUITE.tar.$$" .
    mv "$cache/$SUITE.tar.$$" "$cache/$SUITE.tar"
    rm -rf "$work/base"
fi
podman import --quiet "$cache/$SUITE.tar" "docker.io/library/$base" >/dev/null

# This machine's index and certificate authorities, for pip in the build.
python3 -m pip config list 2>/dev/null |
    sed -n "s/^[^.]*\.\(index-url\|extra-index-url\|proxy\|trusted-host\|timeout\)='\(.*\)'\$/\1 = \2/p" |
    { echo "[global]" && sed '/file:/d'; } >"$work/pip.conf"
authorities=${PIP_CERT:-${SSL_CERT_FILE:-/etc/ssl/certs/ca-certificates.crt}}
[ -f "$authorities" ] || die "no certificate authorities in $authorities: apt-get install ca-certificates"
echo "cert = /run/secrets/ca.pem" >>"$work/pip.conf"

echo "== building $image"
begun=$SECONDS
buildah "${store[@]}" bud --format docker --pull-never --quiet -f docker/Dockerfile -t "$image" \
    --build-arg VERSION="$version" --build-arg REVISION="$(git rev-parse HEAD 2>/dev/null || echo unknown)" \
    --secret id=pip.conf,src="$work/pip.conf" --secret id=ca.pem,src="$authorities" . >"$work/build.log" 2>&1 ||
    die "the build failed: $(tail -30 "$work/build.log")"
size=$(($(podman image inspect --format '{{.Size}}' "$image") / 1000000))
echo "built in $((SECONDS - begun)) s: $size MB, $(podman image inspect --format 'user {{.Config.User}}, version {{index .Config.Labels "org.opencontainers.image.version"}}, revision {{index .Config.Labels "org.opencontainers.image.revision"}}' "$image")"
[ "$size" -le "$MOST_MB" ] || die "the image has $size MB, at most $MOST_MB are wanted"

echo "== running it: read-only, without capabilities"
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
begun=$(date +%s%N)
# Limits are stated, because raising them as podman would is not allowed everywhere.
container=$(podman run --detach --network host --read-only --tmpfs /tmp:size=64m,mode=1777 \
    --cap-drop ALL --security-opt no-new-privileges --ulimit nofile="$(ulimit -n)" --ulimit nproc=4096 --no-healthcheck \
    --volume state:/var/lib/mfcmt --volume "$PWD/docker:/check:ro" --env MFCMT_HOST=127.0.0.1 --env MFCMT_PORT="$port" \
    --env MFCMT_API_KEYS=a-key-for-the-build-check "$image")
until curl -sf "http://127.0.0.1:$port/readyz" >/dev/null; do
    [ "$(podman inspect --format '{{.State.Running}}' "$container")" = true ] || die "it ended: $(podman logs "$container" 2>&1)"
    [ $(($(date +%s%N) - begun)) -lt 120000000000 ] || die "not ready after 120 s: $(podman logs "$container" 2>&1)"
    sleep 0.05
done
echo "ready after $((($(date +%s%N) - begun) / 1000000)) ms; $(curl -sS "http://127.0.0.1:$port/livez")"
podman exec "$container" mfcmt health --ready
podman exec "$container" python /check/try_image.py "http://127.0.0.1:$port" a-key-for-the-build-check
podman exec "$container" sh -c 'if touch /opt/mfcmt/x 2>/dev/null; then exit 1; fi; [ "$(id -u)" != 0 ]' ||
    die "the container's user is root or can write to the image"
echo "== stopping it by SIGTERM"
podman kill --signal TERM "$container" >/dev/null
code=$(podman wait "$container")
[ "$code" = 0 ] || die "it ended with $code: $(podman logs "$container" 2>&1)"
echo "ended with 0"
