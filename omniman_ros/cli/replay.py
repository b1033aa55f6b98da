"""`omniman replay`: repeat a recorded controller, and compare its commands bit for bit."""

import argparse
from pathlib import Path

from omniman_ros.cli.plot import choose_namespace
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import InputError
from omniman_ros.extras import RECORDING

UNREPEATABLE = 2  #: Exit code where nothing can be compared


def run(args: argparse.Namespace) -> int:
    """Run `omniman replay`.

    The exit code is 0 if every command that can be judged is equal, and 1 if one is not.
    CommandError is raised, with the exit code 2, if none can be judged.
    """
    if not RECORDING.is_available:
        raise CommandError(RECORDING.hint)
    from omniman_ros.recording.reader import BagReader
    from omniman_ros.recording.replay import JOURNAL, OUTPUTS, Recorded, compare

    try:
        with BagReader(Path(args.bag)) as bag:
            namespace = choose_namespace(bag.topic_types, args.namespace.strip("/"))
            prefix = f"/{namespace}/" if namespace else "/"
            topics = {prefix + name: name for name in (JOURNAL, *OUTPUTS)}
            recorded = Recorded((topics[t], message) for t, _, message in bag.messages(topics))
        report = compare(recorded)
    except InputError as error:
        raise CommandError(f"{args.bag} cannot be replayed: {error}", UNREPEATABLE) from error
    say(f"{args.bag}: {report.ticks} ticks repeated")
    for topic in OUTPUTS:
        if report.equal[topic] or report.different[topic]:
            say(f"{topic}: {report.equal[topic]} equal, {report.different[topic]} different")
    for (topic, reason), count in sorted(report.not_judged.items()):
        say(f"{topic}: {count} not judged, {reason}")
    if report.gaps:
        say(f"Gaps in the journal: {report.gaps}; what follows one is not judged.")
    if not report.judged:
        raise CommandError(f"{args.bag} cannot be replayed: no command is judged", UNREPEATABLE)
    if report.first is None:
        say("All that is judged is equal, bit for bit.")
        return 0
    first = report.first
    say(
        f"First difference: {first.topic} at {first.stamp // 10**9}.{first.stamp % 10**9:09d} s, "
        f"{first.name}: recorded {first.recorded!r}, replayed {first.replayed!r}"
    )
    return 1
