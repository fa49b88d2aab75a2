#!/usr/bin/python3
"""Runs one program in LinuxCNC without a display. LinuxCNC starts it as its user interface; its end stops LinuxCNC.

`ui.json` says how, all of it optional: `longest_s`, `samples` (record what joints do in every servo cycle), `pins` (written to
`pins.json` at the end), `abort_after` (a text: the program is aborted as soon as the file `log` has it).
It leaves `samples.txt`, and `failed.txt` if something went wrong. The Python is Debian's: its modules of LinuxCNC are for no other."""

import json
import os
import subprocess
import sys
import time

import hal
import linuxcnc

LONGEST = 30.0  # s


def until(what, state, is_there, longest=LONGEST):
    started = time.time()
    while True:
        state.poll()
        if is_there(state):
            return
        if time.time() - started > longest:
            raise RuntimeError(f"LinuxCNC did not get there: {what}")
        time.sleep(0.02)


def has(file, text):
    try:
        with open(file) as log:
            return text in log.read()
    except FileNotFoundError:
        return False


def goes_on(command, state):
    """Presses the button where a program waits (M0)."""
    if state.interp_state == linuxcnc.INTERP_PAUSED:
        command.auto(linuxcnc.AUTO_RESUME)
    return True


def run(how, command, state):
    command.program_open(os.path.abspath("program.ngc"))
    command.auto(linuxcnc.AUTO_RUN, 0)
    until("start", state, lambda s: s.interp_state != linuxcnc.INTERP_IDLE)
    longest = how.get("longest_s", LONGEST)
    if how.get("abort_after"):
        until("abort", state, lambda s: goes_on(command, s) and has(how["log"], how["abort_after"]), longest)
        command.abort()
        command.wait_complete()
    until("end", state, lambda s: goes_on(command, s) and s.interp_state == linuxcnc.INTERP_IDLE and s.inpos, longest)
    time.sleep(0.5)


def main():
    how = {"samples": True}
    if os.path.exists("ui.json"):
        with open("ui.json") as file:
            how = json.load(file)
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
    sampler = subprocess.Popen(["halsampler", "-t", "samples.txt"]) if how.get("samples") else None
    try:
        run(how, command, state)
    finally:
        if sampler:
            sampler.terminate()
            sampler.wait(timeout=10)
    with open("pins.json", "w") as file:
        json.dump({pin: hal.get_value(pin) for pin in how.get("pins", [])}, file)
    while told := errors.poll():
        # What a program says to people (MSG) is none.
        if told[0] in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
            raise RuntimeError(told[1])


try:
    main()
except BaseException as wrong:
    with open("failed.txt", "w") as file:
        file.write(f"{wrong}\n")
    sys.exit(1)
