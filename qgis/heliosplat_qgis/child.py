"""Runs the program: its progress and log while it works, its JSON when it is done, and a signal when the user cancels. Knows no QGIS."""

import json
import os
import queue
import re
import signal
import subprocess
import threading

PROGRESS = re.compile(r"progress (.+) (\d+) %$")
#: How often it is asked whether the user cancelled, seconds.
POLL_S = 0.2
#: After the first signal the program saves what there is; after so long it is stopped at once, seconds.
PATIENCE_S = 60.0


class ChildError(Exception):
    """The program failed or was stopped; the message is its own."""


def run(command, say, progress, cancelled):
    """Runs ``command``. ``say`` gets lines of its log, ``progress`` a label and percents, ``cancelled`` is asked whether to stop.

    Returns what the program wrote on stdout, read as JSON.
    """
    windows = os.name == "nt"
    more = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if windows else {}
    child = subprocess.Popen(
        [str(part) for part in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        env={**os.environ, "HELIOSPLAT_PROGRESS": "lines"},
        **more,
    )
    lines, output, last = queue.Queue(), [], ""
    readers = [
        threading.Thread(target=lambda: [lines.put(line.rstrip()) for line in child.stderr], daemon=True),
        threading.Thread(target=lambda: output.append(child.stdout.read()), daemon=True),
    ]
    for reader in readers:
        reader.start()
    asked, waited = False, 0.0
    while child.poll() is None or not lines.empty() or readers[0].is_alive():
        if cancelled() and child.poll() is None:
            if not asked or waited > PATIENCE_S:
                child.send_signal(signal.CTRL_BREAK_EVENT if windows else signal.SIGINT)
                asked, waited = True, 0.0
            waited += POLL_S
        try:
            line = lines.get(timeout=POLL_S)
        except queue.Empty:
            continue
        found = PROGRESS.match(line)
        if found:
            progress(found.group(1), float(found.group(2)))
        elif line:
            say(line)
            last = line
    for reader in readers:
        reader.join()
    child.stdout.close()
    child.stderr.close()
    if child.returncode == 130:
        # Asked twice, the program ends without a word, and the last line is one of its log.
        raise ChildError(last.replace("error: ", "", 1) if last.startswith("error: ") else "stopped")
    if child.returncode != 0:
        raise ChildError(last.replace("error: ", "", 1) or f"heliosplat ended with code {child.returncode}")
    text = "".join(output)
    try:
        return json.loads(text)
    except ValueError as error:
        raise ChildError(f"heliosplat did not answer in JSON: {text[:200]!r}") from error
