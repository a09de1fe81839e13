//! Checks that the message counts of processes add up. Senders and receivers count separately: each message
//! sent must have one fate, or be counted as in flight by one side at the end.
//!
//! Some messages are counted by neither side. A killed process loses its final counts: for each, as many
//! messages may be missing as can be in flight to and from one process. A link closed because its contact
//! ended drops what a stopped receiver has not read; its sender counts an upper bound of these. Arrivals
//! never exceed sends, and in a run without moves and kills no message may be missing.

use super::SwarmOutcome;
use metamorph_module_agent::in_hand;
use metamorph_protocol::counters::Class;
use metamorph_sim_bridge::world::invariants::MESSAGES_BALANCE;
use metamorph_sim_bridge::world::invariants::Violation;

/// Returns the violation if the counts of a run do not add up. `neighbours` is the largest number of
/// neighbours of an agent at a time; `transparent` is true if the link holds no messages back.
pub fn unbalanced(outcome: &SwarmOutcome, neighbours: usize, transparent: bool) -> Option<Violation> {
    // Without the counts of every incarnation, their sum says nothing.
    if !outcome.missing_counters.is_empty() {
        return None;
    }
    let what = Class::ALL.into_iter().find_map(|class| {
        let most =
            (outcome.unclosed * in_hand(neighbours, transparent) + outcome.loose[class.index()]) as i64;
        let missing = outcome.tally[class].in_flight() - outcome.left[class.index()] as i64;
        match missing {
            ..0 => Some(format!("{} {class} messages more arrived than were sent", -missing)),
            _ if missing > most => Some(format!("{missing} {class} messages are unaccounted for")),
            _ => None,
        }
    })?;
    Some(Violation { invariant: MESSAGES_BALANCE, at: outcome.end, what })
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_module_agent::run_dir::counter_file::{
        AgentCounters, CounterFile, CounterStore as _, directory,
    };
    use metamorph_protocol::counters::Counts;
    use metamorph_protocol::ids::{Incarnation, ModuleId};

    /// The outcome of a run in which one agent sent seven messages, two of them damaged, and another received
    /// them; their counter files are written, edited by `edit`, and read back.
    fn run(closed: bool, edit: impl Fn(&mut AgentCounters, &mut AgentCounters)) -> SwarmOutcome {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(directory(dir.path())).unwrap();
        let (mut sender, mut receiver) = (AgentCounters::default(), AgentCounters::default());
        sender.tally[Class::Seed] = Counts { sent: 7, lost: 1, duplicated: 1, ..Counts::default() };
        sender.left[Class::Seed.index()] = 1;
        receiver.tally[Class::Seed] = Counts { delivered: 3, refused: 2, ..Counts::default() };
        receiver.left[Class::Seed.index()] = 1;
        edit(&mut sender, &mut receiver);
        let mut outcome = SwarmOutcome::default();
        for (id, account) in [(0, sender), (1, receiver)] {
            let (id, incarnation) = (ModuleId(id), Incarnation(0));
            let mut file = CounterFile::create(dir.path(), id, incarnation).unwrap();
            file.write(&AgentCounters { closed, ..account }).unwrap();
            outcome.count(
                id,
                incarnation,
                CounterFile::read(dir.path(), id, incarnation).map_err(|e| e.to_string()),
            );
        }
        outcome
    }

    #[test]
    fn a_ledger_that_is_off_by_one_is_noticed_in_its_class() {
        let what = |outcome: &SwarmOutcome| unbalanced(outcome, 6, true).map(|v| v.what);
        assert_eq!(what(&run(true, |_, _| ())), None);
        let more = run(true, |_, receiver| receiver.tally[Class::Seed].delivered += 1);
        assert_eq!(what(&more).unwrap(), "1 seed messages more arrived than were sent");
        let fewer = run(true, |_, receiver| receiver.tally[Class::Seed].refused -= 1);
        assert_eq!(what(&fewer).unwrap(), "1 seed messages are unaccounted for");
        // The sum over all classes is right here.
        let moved = run(true, |_, receiver| {
            receiver.tally[Class::Seed].refused -= 1;
            receiver.tally[Class::World].refused += 1;
        });
        assert!(what(&moved).is_some());
    }

    #[test]
    fn a_killed_process_and_a_closed_way_explain_some_missing_messages_and_none_too_many() {
        let fewer = |n| run(false, move |sender, _| sender.tally[Class::Seed].sent += n);
        assert_eq!(unbalanced(&fewer(5), 6, true), None);
        assert!(unbalanced(&fewer(2 * in_hand(6, true) + 1), 6, true).is_some());
        let loose = run(true, |sender, _| {
            sender.tally[Class::Seed].sent += 2;
            sender.loose[Class::Seed.index()] = 2;
        });
        assert_eq!(unbalanced(&loose, 6, true), None);
        let more = run(false, |_, receiver| receiver.tally[Class::Seed].delivered += 1);
        assert!(unbalanced(&more, 6, true).is_some());
    }
}
