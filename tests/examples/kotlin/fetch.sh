#!/bin/sh
# A Kotlin compiler and the libraries of docs/mobile.md, from Debian's packages into the folder $1; installs nothing.
set -eu
packages="kotlin libtrove-intellij-java libjetbrains-annotations-java libokhttp-java libokio-java libandroid-json-java"
new=$(mktemp -d "$(dirname "$1")/kotlin.XXXXXX")
cd "$new"
# shellcheck disable=SC2086
apt-get -qq download $packages || { apt-get -qq update && apt-get -qq download $packages; }
for package in *.deb; do
  dpkg -x "$package" .
  rm "$package"
done
mv -T "$new" "$1"
