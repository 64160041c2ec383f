#!/bin/sh
# Track a box through a folder of JPEG frames with curl alone: track.sh FOLDER x,y,w,h > boxes.csv
# SERVICE is the service's URL, KEY an API key, if it needs one.
set -eu
service=${SERVICE:-http://127.0.0.1:8000}
folder=${1:?track.sh FOLDER x,y,w,h} box=${2:?track.sh FOLDER x,y,w,h}
call() { curl --silent --show-error --fail-with-body ${KEY:+-H "Authorization: Bearer $KEY"} "$@"; }
fail() { echo "$1" >&2; exit 1; }

# Sort the frames by the numbers in their names: 2.jpg before 10.jpg.
frames=$(for frame in "$folder"/*.jpg; do [ ! -e "$frame" ] || echo "$frame"; done | sort -V)
[ "$frames" ] || fail "no .jpg in $folder"
first=$(echo "$frames" | head -n 1)
session=$(call -F "frame=@\"$first\"" -F "box=$box" "$service/v1/sessions") || fail "$session"
id=$(echo "$session" | sed 's/.*"id": *"\([^"]*\)".*/\1/')

echo "$frames" | tail -n +2 | while IFS= read -r frame; do
  told=$(call -H 'Content-Type: image/jpeg' --data-binary "@$frame" "$service/v1/sessions/$id/frames") ||
    fail "$frame: $told"
done

call "$service/v1/sessions/$id/trajectory?format=csv"
call -X DELETE "$service/v1/sessions/$id"
