//! The examples and exit codes at the end of the help of each command.

pub const EXIT_CODES: &str = "\
Exit codes:
  0  built: every goal cell is filled (or the command succeeded)
  1  the program itself failed, for example because a file or standard output could not be written
  2  the command line or the scenario is wrong
  3  deadlock: no module can make progress and goal cells are unfilled
  4  livelock: modules move, but no goal cell is filled for longer than the scenario's bound
  5  timeout: the scenario's time limit was reached
  6  unsafe: an invariant broke, such as two modules in one cell
  7  aborted: stopped by Ctrl-C, SIGTERM or SIGHUP, or because shared memory ran short; the report,
     if the run had begun, is partial";

/// Continues the list of exit codes.
pub const JOURNAL_EXIT_CODES: &str = "
  8  a replay differs from the journal
  9  a journal is damaged: bytes were changed, or parts are missing or of another run";
pub const DAMAGED_EXIT_CODE: &str = "
  9  the journal is damaged; the message says where and how";

pub const TOP_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml              one process per module
  metamorph run deploy/scenarios/swarm.toml --link sim   the same in virtual time, repeatable
  metamorph check my.toml                                what would run, or what is wrong
  metamorph clean                                        remove what killed runs left behind

An output file appears at the end of a command, complete; it must not be another file that the command
reads or writes. If standard output cannot be written, the exit code is 1; a reader that closes it early
(`| head`) is not an error.

Logs go to standard error; -v, -vv and -vvv show more, and METAMORPH_LOG takes filters such as
`metamorph_world_controller=debug`.";

pub const RUN_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --kill 3@2s --pause 7@1s..3s
  metamorph run deploy/scenarios/slab-to-sphere.toml --link sim --seed 7 --loss 5%
  metamorph run deploy/scenarios/swarm.toml --link sim --quiet --json - | jq .messages.by_class
  metamorph run deploy/scenarios/swarm.toml --hosts 3

Times are scenario times with a unit: 200ms, 1.5s, 2min. Probabilities are written 5%, 0.05 or 1/20.
Modules are numbered from 0; `metamorph check SCENARIO` prints their number.

Ctrl-C, SIGTERM or SIGHUP ends a run with a partial report; a second one does not wait for agents.";

pub const VIEW_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal
  metamorph view run.journal                             show a recorded run
  metamorph view deploy/scenarios/chair.toml --seed 7    simulate a scenario, and show it
  metamorph view run.journal --port 8080                 at a port that is forwarded from another machine
  metamorph run deploy/scenarios/swarm.toml --view       show processes while they run

The address of the page is printed; open it in a browser of this machine. It works without a network,
listens on the loopback interface only, and admits only requests with the complete address. `?` on the
page lists its keys. Ctrl-C ends it.

Exit codes:
  0  the page was shown until Ctrl-C, SIGTERM or SIGHUP
  1  the program itself failed, for example because no port was free
  2  the command line or the scenario is wrong, or the file is not a journal of this version
  9  the journal is damaged; what comes before the damage was shown until Ctrl-C";

pub const CHECK_EXAMPLES: &str = "\
Examples:
  metamorph check deploy/scenarios/swarm.toml
  metamorph check deploy/scenarios/swarm.toml --link sim --kill 3@2s
  metamorph check deploy/scenarios/swarm.toml --hosts 3

The same options as for `run` are checked together with the scenario. Nothing is run.

Exit codes:
  0  the scenario can be run
  2  the command line or the scenario is wrong; every error names its place, reason and fix";

pub const NEW_EXAMPLES: &str = "\
Examples:
  metamorph new mine.toml
  metamorph new chairs.toml --family metamodule
  metamorph new tower.toml --like rabbit --minimal
  metamorph new --protocol leader           a crate with a protocol, both drivers and tests

Keys that are not set are commented out, with their defaults or examples. An existing file is never
overwritten.

Exit codes:
  0  the scenario or the repository is written
  1  it could not be written completely
  2  the command line is wrong, or the file exists";

pub const SCENARIOS_EXAMPLES: &str = "\
Examples:
  metamorph scenarios
  metamorph scenarios --json | jq -r '.[].name'
  metamorph run swarm
  metamorph check rabbit

Every command that takes a scenario also takes a name of this list. A file of the same name, or of the
name with .toml, wins over it.";

pub const SWEEP_EXAMPLES: &str = "\
Examples:
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..1000
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..1000 --vary link.loss=0%,1%,5%
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..200 --vary protocol.connectivity=forest,cycles \\
      --vary goal.0.growth=scaffold,solid --out results
  metamorph sweep (the same options) --out results --resume

Every combination of the varied values is run with every seed, on the simulated link. A key is the
names of tables and keys joined by dots, with the number of an element for lists: goal.0.growth. A
value is TOML, or text without quotes; commas in brackets or quotes belong to it. At most 10 million
runs and 10,000 combinations.

Files in DIR: runs.csv has a line for every run, summary.json the numbers of the table, report.html
shows them. They are the same on every machine and with any number of jobs.

Ctrl-C ends a sweep; with --out every completed run is kept.

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line, the scenario or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

pub const DIFF_EXAMPLES: &str = "\
Examples:
  metamorph sweep swarm --seeds 0..200 --out forest
  metamorph sweep cycles.toml --seeds 0..200 --out cycles
  metamorph diff forest cycles
  metamorph diff forest cycles --at-least 5% --json diff.json
  metamorph diff forest cycles --by link.loss --plot forest.svg
  metamorph diff a.report.json b.report.json

Of sweeps, combinations with equal values are compared. Shares of outcomes have intervals of
Newcombe and Fisher's exact test; numbers of built runs have the shift of Hodges and Lehmann and the
test of Mann and Whitney. Probabilities are adjusted for the number of tests (Holm). Of reports,
fields that differ are listed, without those about the machine.

Exit codes:
  0  both could be compared, whether they differ or not
  1  the comparison could not be written
  2  the command line, a sweep or a report is wrong";

pub const REPRODUCE_EXAMPLES: &str = "\
Examples:
  metamorph reproduce 4.1 4.2 fig4.5
  metamorph reproduce 4.2 --seeds 100 --out results
  metamorph reproduce 4.1 --quiet --json - | jq '.experiments[0].cells[0]'
  metamorph reproduce graph-signature on-grid reward-map planned
  metamorph reproduce torque transport thesis-7
  metamorph reproduce thesis-7 --gaits fo.json,blf.json,blf-sym.json
  metamorph reproduce c.6 8.2

4.1, 4.2 and fig4.5 run the thesis's experiment with metamodules (4.1.3), re-implemented by the nearest
reading of its text, with every kind (PAR, PER, SRS, SRZ), strategy (greedy, slope, step, and our negotiated)
and order of seeds (circular, crosswise, at-once), and print the published numbers beside ours: with exact
tests, another reading, the effect of each open assumption (from fewer seeds), and whether experiments of
the published size show what the thesis says. The experiments of planners, and thesis-7, are not sweeps:
they are named without these and without --out, and print one table each.

Files in DIR: report.html with tables and plots, and for each of box and chair the scenario and a
directory as `metamorph sweep` writes it; the same for the other reading (box-locks, chair-locks) and for other
orders of the chair's seeds (chair-recipe).

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

pub const RESUME_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal --patience 60s
  (its controller is killed, for example by kill -9)
  metamorph resume run.journal
  metamorph resume run.journal --hosts hosts.toml --old-host-is-gone

The controller hosts the simulated bodies, so without it nothing moves, while modules keep exchanging
messages. Bodies and controller are rebuilt from the journal. Modules wait for --patience; after that, or
if the machine was restarted, the run cannot be resumed. The daemons of a run with --hosts wait as well on
this machine; on other machines they wait for the `fence` of the hosts file, and those that have ended count
as lost. With --old-host-is-gone the run goes on from another machine that has the parts of the journal.";

pub const DOCTOR_EXAMPLES: &str = "\
Examples:
  metamorph doctor
  metamorph doctor --modules 1058
  metamorph doctor --json | jq '.[] | select(.state != \"ok\")'

Nothing is changed. What a swarm needs is computed as `run` does.

Exit codes:
  0  a swarm of this size can run
  1  it cannot; the lines with FAIL say what to change";

pub const SHAPE_EXAMPLES: &str = "\
Examples:
  metamorph shape deploy/shapes/table.obj --pitch 10
  metamorph shape deploy/shapes/rabbit.stl --cells 14 --svg rabbit.svg --write rabbit.toml
  metamorph shape config.xml --part blocks
  metamorph shape config.xml --write case.toml
  metamorph shape deploy/shapes/chair.toml --modules --split
  metamorph shape deploy/shapes/chair.toml --modules --repair any --write repaired.toml

A cell is filled if its centre is inside the solid. In a scenario, the same goal is
    shape = { file = { path = \"rabbit.stl\", pitch = 10 } }
The written scenario lists the cells themselves and does not need the file. Its modules start in a
slab below the goal, or at the places of the configuration.

A drawing is a TOML file with `version = 1` and `cells = [[0, 0, 0], [1, 0, 0]]`. With --modules, cells that
share a face become modules of two; repairs are the fewest changes after which every cell has a partner.

Exit codes:
  0  no obstacle to building it was found before a run
  1  a file could not be written
  2  the command line or the file is wrong, or something cannot be built; every error names its
     place, reason and fix
  3  with --modules: cells stay without a partner; the answer says which, and what to change";

pub const RENDER_EXAMPLES: &str = "\
Examples:
  metamorph render deploy/scenarios/slab-to-sphere.toml --at 50% --out slab-to-sphere.svg
  metamorph render deploy/scenarios/slab-to-sphere.toml --section 'x<11' --color level --width 180mm --out cut.png
  metamorph render deploy/scenarios/swarm.toml --every 250ms --out swarm.gif
  metamorph render deploy/scenarios/swarm.toml --every 5s --out 'frames/{i}.png'
  metamorph render swarm --at 3s --links waits,messages --out links.svg
  metamorph run deploy/scenarios/swarm.toml --journal run.journal
  metamorph render run.journal --at 12s --camera top --only goal --goal ghost > top.svg
  metamorph render results --plot makespan --out makespan.svg --table makespan.csv

Projections are parallel: lengths in the plane of the picture can be measured with the scale bar. In an SVG
every module is a group with its number, role and cell. A figure says in itself how it was made. The same run
and options give the same bytes.

Exit codes:
  0  the figure is written
  1  it could not be written completely
  2  the command line or the scenario is wrong, or there is nothing to draw
  7  stopped by Ctrl-C, SIGTERM or SIGHUP; nothing is written
  9  the journal is damaged";

pub const EXPORT_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --link sim --journal run.journal
  metamorph export run.journal --mcap run.mcap
  metamorph export run.journal --mcap run.mcap --schema ros2
  metamorph export run.journal --at 50% --urdf half.urdf
  metamorph export run.journal --sdf end.sdf --cell 0.05 --mass 0.2

The recording has Foxglove's SceneUpdate on /modules and Log on /log. Open it in Foxglove or in Lichtblick
and show /modules in a 3D panel whose frame is `world`. With --schema ros2 it has MarkerArray on
/modules, TFMessage on /tf and Log on /rosout.

A structure is in metres, kilograms and radians with z up. URDF has a tree of connections and names how
many are left out; SDF has all of them.

Exit codes:
  0  the recording or the structure is written
  1  it could not be written completely
  2  the command line is wrong, or the file is not a journal of this version
  9  the journal is damaged; no recording is left behind";

pub const SCHEMA_EXAMPLES: &str = "\
Examples:
  metamorph schema > scenario.schema.json
  metamorph schema report | jq .properties.outcome

An editor with a TOML language server checks a scenario that begins with
    #:schema scenario.schema.json";

pub const COMPLETION_EXAMPLES: &str = "\
Examples:
  metamorph completions bash > ~/.local/share/bash-completion/completions/metamorph
  metamorph completions zsh > ~/.zfunc/_metamorph
  metamorph completions fish > ~/.config/fish/completions/metamorph.fish";
pub const BENCH_EXAMPLES: &str = "\
Examples:
  metamorph bench                            everything; takes several minutes
  metamorph bench flood wire                 the simulated and the process link, message by message
  metamorph bench growth --most 2500         sizes of up to 2,500 modules
  metamorph bench --quiet --json new.json && jq .flood new.json

What each measures:
  flood   a million simulated modules propagate hop counts from a corner: processor time and memory
  growth  a slab of 100 to 10,000 simulated modules becomes a ball: time, moves, messages, and how they grow
  pyramid a pyramid is built from a plate below it, solid and with tunnels: the same numbers
  chairs  the thesis's chair with every strategy, on all processors: runs per second
  gait    structures of 4 to 10 modules walk: how fast they are simulated, messages, learners
  wire    round trips and throughput of 64 bytes between two processes, beside bare iceoryx2, a Unix
          socket, a pipe and TCP
  swarm   100 to 5,000 processes: starting, exchanging, memory, idling
  churn   1,000 processes, of which 2 and then 20 per second are killed and restarted

Other load increases the times measured in real time (`wire` and `swarm`); compare numbers of one run.

Exit codes:
  0  everything was measured that this machine permits
  1  something could not be measured
  2  the command line is wrong";

pub const REPLAY_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal
  metamorph replay run.journal                       check that a replay matches the journal
  metamorph replay run.journal --until 10s           the state of every module at 10 s
  metamorph replay run.journal --agent 7 --until 5s  the history of module 7 until 5 s

Agents, world and controller receive the recorded inputs, in the order of cause and effect, and must
reach the same states, messages and counts. Of a killed run, the parts in FILE.parts are replayed.

Exit codes:
  0  the replay matches the journal
  1  the program itself failed
  2  the command line is wrong, or the file is not a journal of this version
  8  the replay differs from the journal; the first difference is named
  9  the journal is damaged; the replay matches what comes before the damage";

pub const EXPLORE_EXAMPLES: &str = "\
Examples:
  metamorph explore --seconds 60
  metamorph explore --runs 10000 --family cube --seed 1
  metamorph explore --runs 1 --seed 4711      (one run, with its scenario)

Every run is a small scenario generated from its seed: world, start, goal, strategy, link, faults. Seeds
are consecutive, starting with --seed. All invariants are checked; after all faults, the remaining
modules must build the goal, unless that is impossible. The first failure of each kind is shrunk and
written to DIR as a scenario that `metamorph run FILE --link sim` repeats. With -v each run is logged
before it begins.

At the end, rare paths of the protocols and the simulator that never ran are listed.

Exit codes:
  0  nothing failed
  1  the program itself failed, for example because a file could not be written
  2  the command line is wrong
  3  a run stood still although a plan was left
  6  an invariant broke, or the program panicked, in at least one run
  7  stopped by Ctrl-C, SIGTERM or SIGHUP, before any failure";

pub const CLEAN_EXAMPLES: &str = "\
Removes shared memory, files and stopped processes of this user's runs whose controller was killed.
Active runs are not touched. The next `metamorph run` does the same.

Exit codes:
  0  nothing is left behind
  1  something could not be removed";
