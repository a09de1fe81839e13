//! Journals that are cut, changed or put together from others.

use super::*;
use metamorph_protocol::record::{Event, Who};
use metamorph_protocol::time::Time;
use std::fs;

fn head() -> Head {
    Head::Part { run: RunId([7; 16]), id: ModuleId(3), incarnation: Incarnation(1) }
}
fn record(n: u64) -> Record {
    let event = Event::Violated { invariant: "x".into(), what: "y".repeat(n as usize % 50) };
    Record { at: Time(n), who: Who::Agent(ModuleId(3), Incarnation(1)), event }
}
fn sample(path: &Path) -> Vec<u8> {
    let mut writer = Writer::create(path, &head()).unwrap();
    (0..20).for_each(|n| writer.put(&record(n)));
    drop(writer);
    fs::read(path).unwrap()
}
fn read(path: &Path) -> (Vec<Record>, Option<Torn>) {
    let mut reader = Reader::open(path).unwrap();
    let records = reader.by_ref().map(Result::unwrap).collect();
    (records, reader.torn().cloned())
}

#[test]
fn reads_what_it_writes_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    sample(&path);
    let all: Vec<Record> = (0..20).map(record).collect();
    assert_eq!(read(&path), (all.clone(), None));
    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.head(), &head());
    assert_eq!(reader.by_ref().take(7).count(), 7);
    let mut writer = Writer::go_on(&path, reader.end()).unwrap();
    writer.put(&record(99));
    drop(writer);
    assert_eq!(read(&path), ([&all[..7], &[record(99)]].concat(), None));
}

/// Whatever end a crash leaves, all whole records are read, and the cut is reported.
#[test]
fn a_torn_tail_is_cut_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    let bytes = sample(&path);
    let all: Vec<Record> = (0..20).map(record).collect();
    let mut ends = vec![];
    let mut reader = Reader::open(&path).unwrap();
    ends.push(reader.end().bytes);
    while reader.next().is_some() {
        ends.push(reader.end().bytes);
    }
    for length in ends[0]..bytes.len() as u64 {
        fs::write(&path, &bytes[..length as usize]).unwrap();
        let (records, torn) = read(&path);
        let whole = ends.iter().filter(|e| **e <= length).count() - 1;
        assert_eq!(records, all[..whole]);
        assert_eq!(
            torn.map(|t| (t.whole, t.cut)),
            (!ends.contains(&length)).then(|| { (ends[whole], length - ends[whole]) })
        );
    }
}

#[test]
fn refuses_what_it_does_not_know_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    let good = sample(&path);
    let error = |edit: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = good.clone();
        edit(&mut bytes);
        fs::write(&path, bytes).unwrap();
        Reader::open(&path).unwrap_err()
    };
    assert!(matches!(error(&|b| b[0] = b'X'), JournalError::Magic(_)));
    assert!(matches!(error(&|b| b.truncate(9)), JournalError::NoHead(_)));
    let next = VERSION + 1;
    let newer = error(&|b| b[8..10].copy_from_slice(&next.to_le_bytes()));
    assert!(matches!(newer, JournalError::Version(_, version) if version == next));
    let ours = format!("this program reads version {VERSION}:");
    assert!(newer.to_string().contains(&format!("version {next}")) && newer.to_string().contains(&ours));
    assert!(matches!(error(&|b| b[20] ^= 1), JournalError::Damaged(_)));
    assert!(matches!(error(&|b| b.truncate(12)), JournalError::NoHead(_)));
    assert!(matches!(Reader::open(dir.path()), Err(JournalError::Magic(_) | JournalError::Read(..))));
}

/// Writing to `/dev/full` fails as on a full disk.
#[test]
fn a_full_disk_stops_the_journal_and_is_counted() {
    let full = Writer::create(Path::new("/dev/full"), &head());
    assert!(matches!(full, Err(JournalError::Create(..))));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    let mut writer = Writer::create(&path, &head()).unwrap();
    writer.put(&record(1));
    writer.commit();
    writer.file = Some(File::options().write(true).open("/dev/full").unwrap());
    writer.put(&record(2));
    writer.put(&record(3));
    assert_eq!(writer.lost(), (0, None));
    writer.commit();
    writer.put(&record(4));
    writer.commit();
    assert_eq!(writer.lost().0, 3);
    assert!(writer.lost().1.is_some_and(|why| why.contains("space")));
    assert_eq!(read(&path), (vec![record(1)], None));
}

/// Returns the first damage of a file, after checking that the records before it are unchanged.
fn damage(path: &Path) -> Option<(u64, DamageKind)> {
    let reader = match Reader::open(path) {
        Ok(reader) => reader,
        Err(JournalError::Damaged(damage)) => return Some((damage.at, damage.kind)),
        Err(_) => return None,
    };
    for (n, got) in reader.enumerate() {
        match got {
            Ok(got) => assert_eq!(got, record(n as u64)),
            Err(damage) => {
                assert!(damage.to_string().contains("damaged at byte"), "{damage}");
                return Some((damage.at, damage.kind));
            }
        }
    }
    None
}

/// Returns the ranges of all frames in a file.
fn frames(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    let mut at = START;
    std::iter::from_fn(|| {
        let header = Header::read(*bytes.get(at..)?.first_chunk()?);
        let frame = at..at + HEADER + header.length;
        at = frame.end;
        Some(frame)
    })
    .collect()
}

/// Every changed bit behind the version is damage, also in the last frame and in lengths.
#[test]
fn every_changed_bit_is_damage_at_its_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    let good = sample(&path);
    // The head, one in the middle, and the last.
    for frame in frames(&good).into_iter().step_by(10) {
        for bit in 8 * frame.start..8 * frame.end {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, bytes).unwrap();
            assert_eq!(damage(&path), Some((frame.start as u64, DamageKind::Changed)), "bit {bit}");
        }
    }
}

/// Frames that were removed, repeated, swapped, or taken from the file of another run do not fit.
#[test]
fn frames_out_of_their_place_are_damage() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j");
    let good = sample(&path);
    let frames = frames(&good);
    let (before, a, b) = (&good[..frames[5].start], &good[frames[5].clone()], &good[frames[6].clone()]);
    let after = &good[frames[6].end..];
    let other = Head::Part { run: RunId([8; 16]), id: ModuleId(3), incarnation: Incarnation(1) };
    let mut writer = Writer::create(&path, &other).unwrap();
    (0..20).for_each(|n| writer.put(&record(n)));
    drop(writer);
    let foreign = fs::read(&path).unwrap();
    assert_eq!(foreign.len(), good.len());
    for (bytes, at) in [
        ([before, b, after].concat(), 5),
        ([before, a, a, b, after].concat(), 6),
        ([before, b, a, after].concat(), 5),
        ([before, a, after].concat(), 6),
        ([before, &foreign[frames[5].start..]].concat(), 5),
    ] {
        fs::write(&path, bytes).unwrap();
        assert_eq!(damage(&path), Some((frames[at].start as u64, DamageKind::Order)));
    }
}
