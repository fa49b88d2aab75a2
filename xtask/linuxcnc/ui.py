#!/usr/bin/env python3
"""Runs one program in LinuxCNC without a display, and records what joints do in every servo cycle. LinuxCNC starts it as its user
interface; its end stops LinuxCNC. It leaves `samples.txt`, and `failed.txt` if something went wrong."""

import os
import subprocess
import sys
import time

import hal
import linuxcnc

LONGEST = 30.0  # s


def until(what, state, is_there):
    started = time.time()
    while True:
        state.poll()
        if is_there(state):
            return
        if time.time() - started > LONGEST:
            raise RuntimeError(f"LinuxCNC did not get there: {what}")
        time.sleep(0.02)


def main():
    component = hal.component("abbe-ui")
    component.ready()
    command, state, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    state.poll()
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.home(-1)
    until("home", state, lambda s: all(s.homed[: s.joints]))
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    sampler = subprocess.Popen(["halsampler", "-t", "samples.txt"])
    try:
        command.program_open(os.path.abspath("program.ngc"))
        command.auto(linuxcnc.AUTO_RUN, 0)
        until("start", state, lambda s: s.interp_state != linuxcnc.INTERP_IDLE)
        until("end", state, lambda s: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos)
        time.sleep(0.5)
    finally:
        sampler.terminate()
        sampler.wait(timeout=10)
    told = errors.poll()
    if told:
        raise RuntimeError(told[1])


try:
    main()
except BaseException as wrong:
    with open("failed.txt", "w") as file:
        file.write(f"{wrong}\n")
    sys.exit(1)
