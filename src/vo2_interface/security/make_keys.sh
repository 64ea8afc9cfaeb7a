#!/bin/sh
# Keys and permissions of an SROS 2 graph, by policy.xml beside this script.
# usage: make_keys.sh KEYSTORE; where KEYSTORE is there, what is in it stays, and enclaves that it lacks are added
set -eu
here=$(dirname "$(readlink -f "$0")")
if [ $# -ne 1 ]; then
  echo "make_keys.sh: found $# arguments, need one: the folder of the keys" >&2
  exit 2
fi
if ! ros2 security --help > /dev/null 2>&1; then
  echo "make_keys.sh: found no 'ros2 security', need it: install the package sros2 and source ROS 2" >&2
  exit 2
fi
umask 077
ros2 security generate_artifacts -k "$1" -p "$here/policy.xml"
echo "for every shell that starts a node:"
echo "  export ROS_SECURITY_KEYSTORE='$(readlink -f "$1")' ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce"
echo "and for each node its enclave, such as: ros2 run vo2_plant_sim plant --ros-args --enclave /vo2/plant"
