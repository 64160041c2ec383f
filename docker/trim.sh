#!/bin/sh
# Takes out of the base image what serving does not need, and compiles what is left of Python's library to bytecode
# (the base image comes without, and no process of the service could keep it). The package manager's list stays
# true, so that scanners see what is there.
set -eu
library=$(/usr/local/bin/python3 -c 'import sysconfig; print(sysconfig.get_path("stdlib"))')
for unused in ensurepip idlelib lib2to3 pydoc_data tkinter turtledemo; do rm -rf "${library:?}/$unused"; done
rm -rf "$library"/site-packages/* "$library"/config-* /usr/lib/python3 /usr/local/include /usr/local/bin/pip* \
    /usr/share/doc /usr/share/man /usr/share/locale /usr/share/info /usr/lib/*/gconv /var/cache/* /var/log/* /root/.cache
find "$library" -name __pycache__ -prune -exec rm -rf {} +
dpkg --purge --force-all bash e2fsprogs apt libapt-pkg6.0 gpgv perl-base >/dev/null 2>&1
/opt/mfcmt/bin/python "$(dirname "$0")/bytecode.py" "$library"
