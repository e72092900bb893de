"""The commands of this distribution, which telenano lists without importing what they need."""

COMMANDS = {
    "bag diff": (
        "telenano_lab.studies.diff_command:diff",
        "Compare two recordings message by message, by channel and number.",
    ),
    "bag plot": (
        "telenano_lab.studies.plot_command:plot",
        "Draw fields over time, on the terminal or into a PNG.",
    ),
    "compare": (
        "telenano_lab.studies.compare_command:compare",
        "Draw sessions beside one another, with one table.",
    ),
    "study": (
        "telenano_lab.studies.study_command:app",
        "Study each law in lockstep: stability, transparency.",
    ),
    "study advise": (
        "telenano_lab.experiments.advise_command:advise",
        "Advise a law for a network and a sample, by the benchmark's cells and a trial on the line itself.",
    ),
    "study drift": (
        "telenano_lab.experiments.drift_command:drift",
        "Measure the effect of a drift in z on each law: a steady one, and one that wanders as thermal drift does.",
    ),
    "reproduce": (
        "telenano_lab.studies.reproduce_command:reproduce",
        "Make figures and equations of the paper again, on one page.",
    ),
    "topic pub": (
        "telenano_lab.networks.publish_command:pub",
        "Publish messages instead of a node that does not run, for trials and tests.",
    ),
    "link fit": (
        "telenano_lab.networks.fit_command:fit",
        "Make settings of the link from a log of a line: its delays, how long they last, its stalls and its losses.",
    ),
    "link picture": (
        "telenano_lab.networks.picture_command:picture",
        "Draw the forward direction of networks: delay, its distribution and autocorrelation, stalls, losses, and age.",
    ),
    "link report": (
        "telenano_lab.networks.report_command:report",
        "Show the effect of the link on the messages of a recording: delay, loss, stalls and order, by direction.",
    ),
    "link udp": (
        "telenano_lab.networks.udp_command:udp",
        "Put the link between two programs that send UDP datagrams, one of which sends to LISTEN.",
    ),
    "link probe": (
        "telenano_lab.networks.probe_command:probe",
        "Measure the network between two running sites: delay and loss of each datagram, each way.",
    ),
    "experiment": (
        "telenano_lab.experiments.experiment_command:app",
        "Run trials of people or simulated operators over conditions.",
    ),
    "benchmark": (
        "telenano_lab.experiments.benchmark_command:benchmark",
        "Run the benchmark of laws: which law for which network.",
    ),
    "particles": (
        "telenano_lab.assembly.assemble_command:particles",
        "Find spheres in an image: places, radii and their errors.",
    ),
    "push": (
        "telenano_lab.assembly.push_command:push",
        "Push one particle, in simulated time or on a rig.",
    ),
    "assemble": (
        "telenano_lab.assembly.assemble_command:assemble",
        "Push particles into a pattern, in simulated time.",
    ),
    "sample": ("telenano_lab.microscopy.sample_command:app", "Make or read a surface as a round tip sees it."),
    "curve": (
        "telenano_lab.microscopy.curve_command:app",
        "Measure a force curve of the simulated instrument, beside a measured one.",
    ),
    "curve fit": (
        "telenano_lab.afm_files.curve_fit_command:fit",
        "Fit a contact to all force curves of files: a table with a row for each, and pictures.",
    ),
    "scan": (
        "telenano_lab.microscopy.scan_command:scan",
        "Image a sample: tapping or contact mode, simulated time.",
    ),
    "bag recalibrate": (
        "telenano_lab.calibration.recalibrate_command:recalibrate",
        "Apply another calibration to the raw values of real devices, and write a new recording.",
    ),
    "budget": (
        "telenano_lab.calibration.budget_command:budget",
        "State the error of a session's figures by its sources, and the delay of the loop by its stages.",
    ),
    "calibrate": (
        "telenano_lab.calibration.calibrate_command:app",
        "Calibrate read-out and stiffness from your own measurements.",
    ),
    "inspect": (
        "telenano_lab.afm_files.inspect_command:inspect",
        "Show how a file is read: format, columns, units, sign, parts left out, and the command that uses it.",
    ),
    "sample import": (
        "telenano_lab.afm_files.map_commands:import_map",
        "Convert a recorded map into a file for `afm_node.sample.map`.",
    ),
    "sample info": (
        "telenano_lab.afm_files.map_commands:info",
        "Show the contents of a recorded map, or the facts that it lacks to be felt.",
    ),
}
