"""Loaded into workers by tests: frames that kill their worker, or find no memory; a line for each reconstruction."""

import os
import signal

from plenopiv.run import pair

usual = getattr(pair, "usual_before_tests", pair.reconstructed)  # workers load this more than once
pair.usual_before_tests = usual


def reconstructed(chain, recording, number, progress):
    name = recording.frames[number].name
    with open(os.environ["TEST_LOG"], "a") as log:
        log.write(f"{name}\n")
    if name == os.environ.get("TEST_KILLS"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name == os.environ.get("TEST_HUNGRY"):
        raise MemoryError("so says the test")
    return usual(chain, recording, number, progress)


pair.reconstructed = reconstructed
