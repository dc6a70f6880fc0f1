#!/bin/sh
# Takes from an environment what no process of ours reads: debug symbols, tests, and all that PyBullet ships
# beside its library. Usage: trim.sh ENVIRONMENT
set -eu
packages=$(echo "$1"/lib/python3.*/site-packages)

find "$packages/pybullet_data" -mindepth 1 -maxdepth 1 ! -name '__init__.py' -exec rm -rf {} +
rm -rf "$packages"/pybullet_envs "$packages"/pybullet_examples "$packages"/pybullet_robots "$packages"/eglRenderer*.so
find "$packages" -depth -type d \( -name tests -o -name __pycache__ \) -exec rm -rf {} +
find "$packages" -type f -name '*.pyi' -delete
find "$packages" -type f \( -name '*.so' -o -name '*.so.*' \) ! -path '*.libs/*' -exec strip --strip-unneeded {} +
