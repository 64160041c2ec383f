#!/bin/sh
# Makes docker/.env from docker/.env.example with keys made at random, and docker/admin-key for Prometheus.
# What is there already is kept.
set -eu
cd "$(dirname "$0")"
secret() { od -An -N24 -tx1 /dev/urandom | tr -d ' \n'; }
if [ -e .env ]; then
    echo "docker/.env is there already and stays as it is"
else
    (umask 077 && sed -e "s/^MFCMT_API_KEYS=\$/&$(secret)/" -e "s/^MFCMT_ADMIN_KEY=\$/&$(secret)/" \
        -e "s/^GRAFANA_PASSWORD=\$/&$(secret)/" -e "s/^MFCMT_SIGNING_KEYS=\$/&$(secret)/" .env.example >.env)
    echo "made docker/.env: your clients' key is MFCMT_API_KEYS there, Grafana's password GRAFANA_PASSWORD"
fi
# Prometheus reads it as a user of its own, so others must be able to.
sed -n 's/^MFCMT_ADMIN_KEY=//p' .env | tr -d '\n' >admin-key
chmod 0644 admin-key
