#!/bin/sh
# Track a box through a folder of JPEG frames with curl alone: track.sh FOLDER x,y,w,h > boxes.csv
# SERVICE is the service's URL, KEY an API key where it wants one.
set -eu
service=${SERVICE:-http://127.0.0.1:8000}
folder=$1 box=$2
call() { curl --silent --show-error --fail-with-body ${KEY:+-H "Authorization: Bearer $KEY"} "$@"; }

set -- "$folder"/*.jpg
session=$(call -F "frame=@$1" -F "box=$box" "$service/v1/sessions") || { echo "$session" >&2; exit 1; }
id=$(echo "$session" | sed 's/.*"id": *"\([^"]*\)".*/\1/')
shift

for frame in "$@"; do
  call -H 'Content-Type: image/jpeg' --data-binary "@$frame" "$service/v1/sessions/$id/frames" > /dev/null
done

call "$service/v1/sessions/$id/trajectory?format=csv"
call -X DELETE "$service/v1/sessions/$id"
