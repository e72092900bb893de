"""The faults that the tests of the whole rig inject, what is promised for each, and the table of what happened.

    python tests/stack/ledger.py out/faults.jsonl docs/faults-measured.md

puts what a run entered (TELENANO_LEDGER=out/faults.jsonl pytest tests/stack) into the table of the page; `make
reliability` does both.
"""

import json
import os
import sys
from datetime import date
from pathlib import Path

VARIABLE = "TELENANO_LEDGER"
BEGIN, END = "<!-- faults begin -->", "<!-- faults end -->"

# the fault -> what is promised; the order is that of the table
FAULTS = {
    "kill -9 of controller@master": "hand let go, tip holds, then withdraws; restarted",
    "kill -9 of controller@slave": "hand let go, tip holds, then withdraws; restarted",
    "kill -9 of delay_node@master": "hand let go, tip holds, then withdraws; restarted",
    "kill -9 of afm_node@slave": "hand let go; restarted withdrawn, waits to be armed",
    "kill -9 of haptic_node@master": "tip holds, then withdraws; restarted with the motor off",
    "kill -9 of controller@slave, afm_node@slave, one process": "hand let go; restarted together, the "
    "tip withdrawn, and waits to be armed",
    "kill -9 of delay_node@master, controller@master, haptic_node@master, one process": "tip holds, then withdraws; "
    "restarted together with the motor off",
    "kill -9 of recorder@master": "at most a flush interval is lost, the rig goes on; a second file follows",
    "each process, with recorder and page's server, stopped for 0.05, 0.3 and 2 s under wave, link of 20 ms": "nothing "
    "past its deadline of 50 ms is obeyed, the tip does not jump, and bears no more than in the swings before; each "
    "process reports it",
    "a frame of 20 MB at the endpoint of a console": "told by each reader, which connects anew within 2 s; the next "
    "command is obeyed",
    "the recorder is killed in a session": "figure and summary are made of all parts; what is missing is stated",
    "the recording is removed while it is written": "reported; the recording goes on in another file",
    "all files that a rig was started with, and the folders that it writes to, are removed, and each node is killed or "
    "aborted": "each comes back with what it was started with, and waits to be armed; the folders are made again, the "
    "recording goes on",
    "the disk of the recording is full": "the rig goes on; reported by `up` and `status`; summary of what was recorded",
    "the disk for an image, a curve or a recording of a running rig is full": "the command ends with 1 and names the "
    "place; no image or curve is left half written, the tip is withdrawn, the rig goes on",
    "the folder of sockets is full while a page has the hand": "the page keeps it, others are refused with the path; "
    "the loop, `status` and an emergency stop go on",
    "the runtime folder is removed under a rig": "made again within a second and reported; meanwhile an emergency "
    "stop, `session`, `status` and a second `up` find the rig all the same",
    "the runtime folder is removed and cannot be made again": "both devices stop by themselves, and the rig ends with "
    "the reason",
    "a second rig is started after the folder of the first was removed": "it sees the first and is rig 2; the end of "
    "the first removes nothing of it",
    "a law of a package never returns": "its process is ended after 1.5 s of processor time, hand let go; restarted",
    "a law of a package never returns in a process of several": "the process is ended within 60 ms of the turn; "
    "restarted together",
    "a node that dies again and again in a process of several": "the rig is stopped with a summary of the deaths",
    "a node that dies again and again": "the rig is stopped with a summary of the deaths",
    "the page that has the hand is killed": "the hand is lost within 1 s of the server's time, and the tip withdrawn",
    "the page that has the hand stands still": "lost within 1 s of the server's time, the tip withdrawn; what it sends "
    "afterwards is refused",
    "the server of the page stands still while a page has the hand": "nobody has the hand after 1 s; the tip is "
    "withdrawn when the server goes on",
    "the server of the page is killed while a page has the hand": "hand let go; the new server withdraws the tip",
    "the hand stands still and is killed while a page has it": "the lease is the page's all the while, and an "
    "emergency stop asks for none",
    "a node that spins in a process of several": "all of its process are killed and restarted together; one that is "
    "stopped keeps its process",
    "a node that spins": "killed and restarted as one that died; one that is stopped keeps its process",
    "the slave's site starts late": "the master waits, reports for what, and begins by itself",
    "the slave's address is not reached": "reported after 5 s with what to look for, and again every minute",
    "a key that is not listed": "receives nothing; counted, logged",
    "a wrong server key": "receives nothing; counted, logged",
    "no encryption": "receives nothing; counted, logged",
    "an observer that sends e-stop": "no node obeys; counted, logged",
    "a key revoked while it listens": "its connections are closed within seconds; the others come back",
    "500 half-open connections": "closed after 5 s, counted; the loop goes on",
    "garbage at every endpoint that is open to others": "refused and counted; no process ends, the loops keep 95 % of "
    "their rate, and an emergency stop comes through",
    "a frame of 1 GB announced": "that connection is closed, no memory is taken",
    **{
        f"{node}, an end of the link, stands still for {seconds} s": "hand let go, tip holds, then withdraws; nothing "
        "that waited is obeyed, and nobody is started again"
        for node in ("delay_node@master", "controller@slave")
        for seconds in (30, 300)
    },
    "two sites over a network, a process each": "both press, an emergency stop crosses, and the recording is whole",
    "the cable is pulled for 5 s": "hand let go, tip holds, then withdraws; connected again without a restart",
    "the cable is pulled for 60 s": "hand let go, tip holds, then withdraws; connected again without a restart",
    "the line becomes 1 Mbit/s in a session": "named with its queue; samples are left out until the queue is gone",
    "a line of 256 kbit/s": "`up` refuses, with the numbers",
    "UDP is blocked in a session, 20 ms each way": "the loop goes on over TCP, and stands still for at most 100 ms",
    "TCP is cut between the sites, and UDP is not": "once the ends miss the connection no sample counts: tip holds, "
    "then withdraws, hand let go",
    **{
        f"each way and each transport between the sites blocked, alone and together, {over}": "the tip follows at most "
        "0.5 s, and the hand is driven at most 0.1 s, beyond the last answer that has reached the hand"
        for over in ("over a cable", "past a relay", "through a relay")
    },
    "the relay is killed while the datagrams go past it": "hand and tip feel each other until the ends miss the "
    "connection; then no sample counts: hand let go, tip holds, then withdraws",
    **{
        f"an emergency stop for the tip while {what}": "the link keeps it: no sample passes, and the tip follows "
        "nothing until it has obeyed the stop"
        for what in ("nothing crosses between the sites", "no TCP crosses between the sites")
    },
    "a flood into a link that stands still and holds, `link set` in the middle, an emergency stop, kill -9": "no more "
    "waits than the queue's limit, what is dropped is counted, the stop is not held, settings hold from then on; "
    "started again the link holds nothing",
    "the slave's site is killed and started again": "hand let go; the session goes on, the tip waits to be armed",
    "the master's site is killed and started again": "tip holds, then withdraws; a new session begins by itself",
    "the launcher of a site that is a service is killed, and aborted": "its nodes end with their devices safe; started "
    "again by its unit, it records into a new folder, and the tip waits to be armed",
    "bytes of TCP between the sites are altered behind a right checksum": "no sample that was altered counts; what is "
    "aborted is started again, and the tip waits to be armed",
    "the relay is killed and started again": "where the datagrams go through it: hand let go, tip holds, then "
    "withdraws; joined again without a restart of the sites, the tip waits to be armed",
    "a relay that drops, repeats, holds back, forges and floods": "genuine samples alone are obeyed, none after "
    "a newer one; the rest is refused and counted; the link stays with datagrams",
    "an arm that waited in a stopped AFM": "refused and answered; the tip stays in emergency stop",
    "an arm at a stopped AFM, then an emergency stop": "the arm is void, the tip stays in emergency stop",
    "an AFM stopped for longer than the emergency stop is sent": "in emergency stop when it goes on, before it obeys",
    "an emergency stop while the AFM is being started again without a folder": "it comes back in emergency stop",
    "an arm that waits in the page's server when an emergency stop comes": "given up, also when the page has left; "
    "both devices stay latched",
    "an emergency stop while a console is at work": "both devices stop",
    "an emergency stop from the page of the view": "both devices stop, for an observer as well",
    "the wall clock is set by an hour, forwards and back": "commands given afterwards are obeyed, a stop too",
    "the AFM's process is killed in its container": "hand let go; restarted by the engine, waits to be armed",
}

# What a fault is called that was injected into a rig with a process a site; the promise is the same.
A_SITE = ", a process a site"
FAULTS |= {
    fault + A_SITE: promise
    for fault, promise in FAULTS.items()
    if fault.startswith(
        (
            "each process, ",
            "the runtime folder ",
            "a second rig ",
            "a flood into ",
            "an arm that waited in a stopped AFM",
            "an arm at a stopped AFM",
            "an AFM stopped ",
            "an emergency stop while the AFM ",
            "an emergency stop while a console ",
            "an emergency stop from the page ",
        )
    )
}


def record(fault: str, happened: str) -> None:
    """Enter what happened on a fault, where a run is to fill the table."""
    if fault not in FAULTS:
        raise KeyError(f"{fault} is not among the faults that are promised anything")
    path = os.environ.get(VARIABLE)
    if path:
        with Path(path).open("a", encoding="utf-8") as out:
            out.write(json.dumps({"fault": fault, "happened": happened, "day": f"{date.today()}"}) + "\n")


def table(entries: dict[str, tuple[str, str]]) -> str:
    """Give the table in Markdown, with what happened and on which day; a fault without an entry is left out of it."""
    rows = [f"| {fault} | {FAULTS[fault]} | {' | '.join(entries[fault])} |" for fault in FAULTS if fault in entries]
    return "\n".join(["| fault | promised | happened | on |", "|---|---|---|---|", *rows])


def main(entered: Path, page: Path) -> None:
    """Put the newest entry of each fault into the table of the page; what was not entered stays as it is."""
    text = page.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    old, _, tail = rest.partition(END)
    cells = [line.strip("| ").split(" | ") for line in old.strip().splitlines()[2:]]
    entries = {cell[0]: (cell[2], cell[3]) for cell in cells}
    for line in entered.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        entries[entry["fault"]] = (entry["happened"], entry["day"])
    page.write_text(f"{head}{BEGIN}\n{table(entries)}\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
