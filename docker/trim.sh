#!/bin/sh
# Takes out of the base image what serving does not need, and compiles what is left of Python's library to bytecode
# (the base image comes without, and no process of the service could keep it). What stays of Debian is what Python and
# its libraries link to, a shell and coreutils; the list of packages in /var/lib/dpkg stays true, for scanners.
set -eu
library=$(/usr/local/bin/python3 -c 'import sysconfig; print(sysconfig.get_path("stdlib"))')
for unused in ensurepip idlelib lib2to3 pydoc_data tkinter turtledemo; do rm -rf "${library:?}/$unused"; done
rm -rf "$library"/site-packages/* "$library"/config-* /usr/lib/python3 /usr/local/include /usr/local/bin/pip* \
    /usr/share/doc /usr/share/man /usr/share/locale /usr/share/info /usr/share/zoneinfo/right \
    /usr/share/zoneinfo/posix /usr/lib/*/gconv /var/cache/* /var/log/* /root/.cache
find "$library" -name __pycache__ -prune -exec rm -rf {} +
# Nothing is to run when a package goes; those that the base does not have are passed over.
rm -f /var/lib/dpkg/info/*.prerm /var/lib/dpkg/info/*.postrm
dpkg --purge --force-all adduser apt bash debconf diffutils e2fsprogs findutils gpgv grep gzip hostname libapt-pkg6.0 \
    libaudit-common libaudit1 libcap-ng0 libdb5.3 libext2fs2 libgcrypt20 libgmp10 libgnutls30 libgpg-error0 \
    libhogweed6 libidn2-0 libnettle8 libp11-kit0 libpam-modules libpam-modules-bin libpam-runtime libpam0g \
    libseccomp2 libsemanage-common libsemanage2 libsepol2 libss2 libsystemd0 libtasn1-6 libudev1 libunistring2 \
    libxxhash0 login logsave mawk mount ncurses-bin openssl passwd perl-base sed sysvinit-utils tar util-linux \
    util-linux-extra >/dev/null 2>&1
rm -rf /usr/bin/dpkg* /usr/sbin/dpkg* /usr/lib/dpkg /usr/share/dpkg
/opt/mfcmt/bin/python "$(dirname "$0")/bytecode.py" "$library"
