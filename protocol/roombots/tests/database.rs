//! The motion database: every count of its generator, its bytes, and that its sweeps are complete.

use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use metamorph_roombots::body::bodies;
use metamorph_roombots::collision::{SHRINK, self_collision};
use metamorph_roombots::database::{CellSet, Database, DatabaseError, Direction, Step, Table};
use metamorph_roombots::posture::{Posture, is_middle};
use metamorph_roombots::shape::{Shape, hand};
use metamorph_roombots::sweep::{CORE_DEPTH, FloorContact, GRAZE_DEPTH, Sweeper, entry_depth};
use metamorph_roombots::{CELL_METRES, HALF_EDGE, Kind};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

static DATABASE: LazyLock<Database> = LazyLock::new(Database::build);

fn shape(table: &Table, posture: u16) -> Shape {
    table.chains()[usize::from(table.postures()[usize::from(posture)].chain)].shape
}

fn directions(posture: Posture) -> [Face; 3] {
    let d = posture.placement().directions;
    [d[0], d[1], d[2]]
}

#[test]
fn sizes() {
    // Postures, main set, cell chains, chains outside the main set, strict steps, steps if 3.2 mm
    // into the floor are tolerated, landings, landing postures, longest way between chains.
    for (kind, expected) in [
        (Kind::Single, [36, 36, 3, 0, 60, 60, 4, 4, 2]),
        (Kind::Par, [1056, 1008, 49, 0, 3864, 4032, 20, 64, 8]),
        (Kind::Srs, [1056, 948, 51, 6, 3432, 3576, 36, 80, 7]),
        (Kind::Per, [1056, 912, 49, 6, 3000, 3120, 34, 96, 7]),
        (Kind::Srz, [1056, 948, 51, 6, 3432, 3576, 36, 80, 7]),
    ] {
        let t = DATABASE.table(kind);
        let n = t.chains().len() as u16;
        let ways = (0..n).flat_map(|a| (0..n).filter_map(move |b| t.min_steps(a, b)));
        let found = [
            t.postures().len(),
            t.postures().iter().filter(|p| p.main).count(),
            t.chains().len(),
            t.chains().iter().filter(|c| !t.chain_is_main(c)).count(),
            t.strict_steps().count(),
            t.steps().len(),
            t.landings().len(),
            t.postures().iter().filter(|p| p.landing.is_some()).count(),
            usize::from(ways.max().unwrap()),
        ];
        assert_eq!(found, expected, "{kind}");
        // Every landing is reached from the main set.
        assert!(t.landings().iter().all(|l| t.is_usable(l)), "{kind}");
    }
}

#[test]
fn shapes_and_their_postures() {
    use Shape::{I, L, S, Twisted, U};
    let postures_and_chains = |kind: Kind| {
        let t = DATABASE.table(kind);
        let mut all: BTreeMap<Shape, (usize, usize)> = BTreeMap::new();
        for chain in t.chains() {
            let entry = all.entry(chain.shape).or_default();
            entry.0 += chain.postures.len();
            entry.1 += 1;
        }
        all
    };
    let par = [(I, (144, 3)), (L, (480, 20)), (S, (240, 10)), (Twisted, (192, 16))];
    let shear = [(I, (144, 3)), (L, (480, 20)), (S, (120, 10)), (U, (120, 10)), (Twisted, (192, 8))];
    let per = [(I, (144, 3)), (L, (480, 20)), (U, (240, 10)), (Twisted, (192, 16))];
    assert_eq!(postures_and_chains(Kind::Par), par.into());
    assert_eq!(postures_and_chains(Kind::Srs), shear.into());
    assert_eq!(postures_and_chains(Kind::Srz), shear.into());
    assert_eq!(postures_and_chains(Kind::Per), per.into());

    // The outsiders: flat U and S of the shear kinds, flat U and flat-start 3D-S of PER.
    for (kind, expected) in [
        (Kind::Srs, vec![(S, 2), (U, 4)]),
        (Kind::Srz, vec![(S, 2), (U, 4)]),
        (Kind::Per, vec![(U, 4), (Twisted, 2)]),
    ] {
        let t = DATABASE.table(kind);
        let mut outside: BTreeMap<Shape, usize> = BTreeMap::new();
        for chain in t.chains().iter().filter(|c| !t.chain_is_main(c)) {
            *outside.entry(chain.shape).or_default() += 1;
            assert!(chain.cells[..3].iter().all(|c| c.z == 0), "{kind} {:?}", chain.cells);
        }
        assert_eq!(outside.into_iter().collect::<Vec<_>>(), expected, "{kind}");
    }

    // Handedness of the twisted shape.
    for (kind, expected) in
        [(Kind::Par, vec![-1, 1]), (Kind::Srs, vec![-1]), (Kind::Per, vec![-1, 1]), (Kind::Srz, vec![1])]
    {
        let hands: BTreeSet<i8> = Posture::all(kind)
            .filter(|p| Shape::of(directions(*p)) == Some(Twisted))
            .map(|p| hand(directions(p)))
            .collect();
        assert_eq!(hands, expected.into_iter().collect(), "{kind}");
    }
}

#[test]
fn canonical_joint_vectors_have_their_shapes() {
    use Face::{Down, East, North, South, Up};
    type Row = (&'static str, [Face; 3], [Option<[i16; 6]>; 4]);
    let rows: [Row; 7] = [
        ("I", [Up, Up, Up], [Some([0; 6]); 4]),
        (
            "L",
            [Up, Up, East],
            [
                Some([0, 0, 0, 120, 0, 0]),
                Some([0, -90, 0, 120, 0, 0]),
                Some([0, 90, 0, -120, 0, 0]),
                Some([0, 0, 0, -120, 0, 0]),
            ],
        ),
        ("L", [Up, East, East], [Some([0, 0, 120, 0, 0, 0]); 4]),
        (
            "S",
            [Up, East, Up],
            [
                Some([0, 0, 120, -120, 0, 0]),
                Some([0, 0, 120, 120, 0, 0]),
                None,
                Some([0, -90, -120, -120, 0, 0]),
            ],
        ),
        (
            "U",
            [Up, East, Down],
            [
                None,
                Some([0, -90, -120, -120, 0, 0]),
                Some([0, 0, 120, -120, 0, 0]),
                Some([0, 0, 120, 120, 0, 0]),
            ],
        ),
        (
            "3D-S",
            [Up, East, North],
            [
                Some([0, 0, 120, 120, 0, 0]),
                None,
                Some([0, -90, -120, -120, 0, 0]),
                Some([0, 0, 120, -120, 0, 0]),
            ],
        ),
        (
            "3D-S",
            [Up, East, South],
            [
                Some([0, -90, -120, -120, 0, 0]),
                Some([0, 0, 120, -120, 0, 0]),
                Some([0, 0, 120, 120, 0, 0]),
                None,
            ],
        ),
    ];
    for (name, wanted, vectors) in rows {
        for (kind, vector) in Kind::METAMODULES.into_iter().zip(vectors) {
            let makers = Posture::all(kind).filter(|p| directions(*p) == wanted);
            let degrees: Vec<Vec<i16>> = makers.map(Posture::degrees).collect();
            match vector {
                Some(q) => assert!(degrees.contains(&q.to_vec()), "{kind} {name} {wanted:?} {q:?}"),
                None => assert_eq!(degrees, Vec::<Vec<i16>>::new(), "{kind} {name} {wanted:?}"),
            }
        }
    }
}

#[test]
fn strict_steps_by_pair_of_shapes() {
    use Shape::{I, L, S, Twisted, U};
    let pairs = |kind: Kind| {
        let t = DATABASE.table(kind);
        let mut all: BTreeMap<(Shape, Shape), usize> = BTreeMap::new();
        for step in t.strict_steps() {
            let (a, b) = (shape(t, step.from), shape(t, step.to));
            *all.entry((a.min(b), a.max(b))).or_default() += 1;
        }
        all
    };
    let par = [
        ((I, I), 288),
        ((I, L), 288),
        ((L, L), 1296),
        ((L, S), 240),
        ((L, Twisted), 336),
        ((S, S), 528),
        ((S, Twisted), 336),
        ((Twisted, Twisted), 552),
    ];
    let shear = [
        ((I, I), 288),
        ((I, L), 288),
        ((L, L), 1296),
        ((L, S), 120),
        ((L, U), 96),
        ((L, Twisted), 312),
        ((S, S), 264),
        ((S, Twisted), 168),
        ((U, U), 48),
        ((Twisted, Twisted), 552),
    ];
    let per = [
        ((I, I), 288),
        ((I, L), 288),
        ((L, L), 1296),
        ((L, U), 192),
        ((L, Twisted), 288),
        ((U, U), 96),
        ((Twisted, Twisted), 552),
    ];
    assert_eq!(pairs(Kind::Par), par.into());
    assert_eq!(pairs(Kind::Srs), shear.into());
    assert_eq!(pairs(Kind::Srz), shear.into());
    assert_eq!(pairs(Kind::Per), per.into());
}

#[test]
fn swept_cells() {
    let mut occurring = CellSet::default();
    let (mut steps, mut core, mut graze) = (0, 0, 0);
    for kind in Kind::METAMODULES {
        for step in DATABASE.table(kind).strict_steps() {
            assert!((4..=31).contains(&step.core.len()), "{kind}");
            assert!((1..=12).contains(&step.graze.len()), "{kind}");
            assert!(!step.core.meets(&step.graze));
            steps += 1;
            core += step.core.len();
            graze += step.graze.len();
            occurring = occurring.union(&step.core).union(&step.graze);
        }
    }
    assert_eq!(occurring.len(), 124);
    let mean = |n: usize| f64::from(n as u32) / f64::from(steps);
    assert!((mean(core) - 10.6).abs() < 0.1 && (mean(graze) - 3.2).abs() < 0.05, "{core} {graze} {steps}");
}

/// Mean number of steps between two different chains that are connected.
#[test]
fn steps_between_chains() {
    for (kind, expected) in [(Kind::Par, 3.06), (Kind::Srs, 3.04), (Kind::Per, 3.05), (Kind::Srz, 3.04)] {
        let t = DATABASE.table(kind);
        let n = t.chains().len() as u16;
        let pairs = (0..n).flat_map(|a| (0..n).map(move |b| (a, b))).filter(|(a, b)| a != b);
        let steps: Vec<f64> = pairs.filter_map(|(a, b)| t.min_steps(a, b)).map(f64::from).collect();
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        assert!((mean - expected).abs() < 0.005, "{kind}: {mean}");
    }
}

/// All 36 postures of a module are connected; between two landings there are 3 to 5 steps.
#[test]
fn single_module_moves() {
    let t = DATABASE.table(Kind::Single);
    let landed: Vec<u16> = t.landings().iter().flat_map(|l| l.postures.clone()).collect();
    let mut lengths = BTreeSet::new();
    for from in &landed {
        // After landing the head is the foot.
        let start = t.reversed(*from).unwrap();
        for to in landed.iter().filter(|to| **to != start) {
            let way = t.shortest_path(start, &CellSet::default(), |p| p == *to).unwrap();
            lengths.insert(way.steps.len());
        }
    }
    assert_eq!((lengths.first(), lengths.last()), (Some(&3), Some(&5)));
}

/// SRS is the mirror image of SRZ step by step; PAR and PER are their own.
#[test]
fn the_mirror_image_of_a_database_is_a_database() {
    let image = |set: &CellSet| -> BTreeSet<Cell> {
        DATABASE.resolve(set).map(|c| Cell::new(c.y, c.x, c.z)).collect()
    };
    for kind in Kind::ALL {
        let (t, m) = (DATABASE.table(kind), DATABASE.table(kind.mirrored()));
        let mirrored: BTreeMap<(u16, u16), &Step> = m.steps().iter().map(|s| ((s.from, s.to), s)).collect();
        for step in t.steps() {
            let at = |p: u16| m.find(t.postures()[usize::from(p)].posture.mirrored()).unwrap();
            // Angles change sign, so the mirrored step is stored from its other end.
            let other = mirrored[&(at(step.to), at(step.from))];
            assert_eq!((other.joint, other.floor), (step.joint, step.floor), "{kind}");
            assert_eq!(image(&step.core), DATABASE.resolve(&other.core).collect(), "{kind}");
            assert_eq!(image(&step.graze), DATABASE.resolve(&other.graze).collect(), "{kind}");
        }
        assert_eq!(t.steps().len(), m.steps().len());
    }
}

/// Random steps run again with five times as many samples and the exact bodies: every cell entered
/// is listed, nothing touches the floor or itself. Backwards the same, since the samples are.
#[test]
fn no_step_sweeps_a_cell_it_does_not_list() {
    const MARGIN: f64 = 1e-4;
    let mut rng = Rng::named(77, "resampling", 0);
    for kind in Kind::ALL {
        let t = DATABASE.table(kind);
        let strict: Vec<&Step> = t.strict_steps().collect();
        for _ in 0..if kind == Kind::Single { 12 } else { 30 } {
            let step = strict[rng.below(strict.len() as u64) as usize];
            let core: BTreeSet<Cell> = DATABASE.resolve(&step.core).collect();
            let known: BTreeSet<Cell> = DATABASE.resolve(&step.core.union(&step.graze)).collect();
            let posture = t.postures()[usize::from(step.from)].posture;
            let joint = usize::from(step.joint);
            let turn = if is_middle(joint) { 90.0 } else { 120.0 };
            for i in 0..=600 {
                let mut q = posture.radians();
                q[joint] += (turn * f64::from(i) / 600.0f64).to_radians();
                let cubes = bodies(kind, &q).unwrap();
                assert!(!self_collision(&cubes, SHRINK), "{kind} {:?} joint {joint}", posture.degrees());
                for body in &cubes {
                    assert!(body.lowest() > -0.3e-3 / CELL_METRES);
                    for cell in cells_near(&body.centre) {
                        if core.contains(&cell) {
                            continue;
                        }
                        let limit = if known.contains(&cell) { CORE_DEPTH } else { GRAZE_DEPTH };
                        let centre =
                            Vector3::new(f64::from(cell.x), f64::from(cell.y), f64::from(cell.z) + HALF_EDGE);
                        let deeper = entry_depth(body, &centre, limit + MARGIN);
                        assert_eq!(deeper, None, "{kind} {:?} joint {joint} {cell}", posture.degrees());
                    }
                }
            }
        }
    }
}

fn cells_near(centre: &Vector3<f64>) -> Vec<Cell> {
    let at =
        Cell::new(centre.x.round() as i16, centre.y.round() as i16, (centre.z - HALF_EDGE).round() as i16);
    let range = -1i16..=1;
    let mut all = Vec::new();
    for x in range.clone() {
        for y in range.clone() {
            all.extend(range.clone().map(|z| at + Cell::new(x, y, z)).filter(|c| c.z >= 0));
        }
    }
    all
}

/// The verdicts rest on depths that are well apart, so no rounding decides them.
#[test]
fn depths_are_well_separated() {
    let mut sweeper = Sweeper::new();
    for kind in Kind::ALL {
        for posture in Posture::all(kind).filter(|p| p.placement().above_floor()) {
            for joint in 0..kind.joints() {
                if posture.turned(joint).placement().above_floor() {
                    sweeper.step(posture, joint);
                }
            }
        }
    }
    let apart = |depths: Vec<f64>, limits: &[f64], gap: f64| {
        assert!(depths.len() > 5);
        for limit in limits {
            let nearest = depths.iter().map(|d| (d - limit).abs()).fold(f64::MAX, f64::min);
            assert!(nearest > gap, "{nearest} mm from {limit} mm");
        }
    };
    apart(sweeper.depths_of_entry(), &[2.2, 11.0], 0.1);
    let reaches = sweeper.depths_into_floor();
    apart(reaches.clone(), &[0.3, 6.0, 15.0], 0.25);
    let classes: BTreeSet<FloorContact> =
        reaches.iter().map(|mm| FloorContact::of_depth(mm / 1000.0 / CELL_METRES)).collect();
    assert_eq!(classes.len(), 4);
    // Own cubes: the deepest contact that is allowed is 1.2 mm, the lightest forbidden one 8 mm.
    let own = sweeper.own_contacts();
    let (allowed, forbidden): (Vec<f64>, Vec<f64>) = own.into_iter().partition(|mm| *mm < 4.0);
    let deepest = allowed.iter().copied().fold(f64::MIN, f64::max);
    let lightest = forbidden.iter().copied().fold(f64::MAX, f64::min);
    assert!(deepest < 1.25 && lightest > 8.0, "{deepest} {lightest}");
}

#[test]
fn ways_are_made_of_steps() {
    for kind in Kind::METAMODULES {
        let t = DATABASE.table(kind);
        let start = t.find(Posture::zero(kind)).unwrap();
        for wanted in Shape::ALL {
            let Some(way) = t.path_to_shape(start, wanted) else {
                let absent = [(Kind::Par, Shape::U), (Kind::Per, Shape::S)];
                assert!(absent.contains(&(kind, wanted)), "{kind} {wanted}");
                continue;
            };
            assert_eq!(way.postures.len(), way.steps.len() + 1);
            assert_eq!(shape(t, *way.postures.last().unwrap()), wanted);
            for (i, (step, direction)) in way.steps.iter().enumerate() {
                let step = &t.steps()[usize::from(*step)];
                let ends = match direction {
                    Direction::Forward => (step.from, step.to),
                    Direction::Backward => (step.to, step.from),
                };
                assert_eq!(ends, (way.postures[i], way.postures[i + 1]));
                assert_eq!(step.floor, FloorContact::Free);
                assert!(step.core.without(&way.core).is_empty());
            }
            assert!(!way.core.meets(&way.graze));
            // Every step can be undone: the way back is as long.
            let end = *way.postures.last().unwrap();
            let back = t.shortest_path(end, &CellSet::default(), |p| p == start).unwrap();
            assert_eq!(back.steps.len(), way.steps.len());
        }
        // An obstacle on the way makes it longer or closes it; it is never swept.
        let blocked = DATABASE.cell_set([Cell::new(1, 0, 1)]);
        if let Some(way) = t.shortest_path(start, &blocked, |p| shape(t, p) == Shape::L) {
            assert!(!way.core.meets(&blocked) && !way.graze.meets(&blocked));
        }
    }
}

#[test]
fn bytes_are_reproducible_and_read_back() {
    let bytes = DATABASE.to_bytes();
    assert_eq!(Database::build().to_bytes(), bytes);
    assert_eq!(Database::from_bytes(&bytes).as_ref(), Ok(&*DATABASE));
    // Pinned: a change of the generator or of the format must raise VERSION and change this.
    assert_eq!(bytes.len(), 310_302);
    let checksum = u32::from_le_bytes(*bytes.last_chunk().unwrap());
    assert_eq!(checksum, 0x35a2_23e1, "{checksum:#010x}");
}

#[test]
fn damaged_bytes_are_refused() {
    let bytes = DATABASE.to_bytes();
    assert_eq!(Database::from_bytes(b""), Err(DatabaseError::NotADatabase));
    assert_eq!(Database::from_bytes(b"MMRBDB"), Err(DatabaseError::NotADatabase));
    assert_eq!(Database::from_bytes(b"something else entirely"), Err(DatabaseError::NotADatabase));
    let mut newer = bytes.clone();
    newer[6] += 1;
    let error = Database::from_bytes(&newer).unwrap_err();
    assert!(error.to_string().contains("build it anew"), "{error}");
    assert!(matches!(error, DatabaseError::Version { .. }));
    for cut in [9, 100, bytes.len() - 1] {
        assert_eq!(Database::from_bytes(&bytes[..cut]), Err(DatabaseError::Checksum));
    }
    // Whatever the content, a right checksum does not make it panic.
    let mut rng = Rng::named(4, "damage", 0);
    for _ in 0..40 {
        let mut wrong = bytes.clone();
        let at = 8 + rng.below(wrong.len() as u64 - 12) as usize;
        wrong[at] = rng.below(256) as u8;
        reseal(&mut wrong);
        if let Err(error) = Database::from_bytes(&wrong) {
            assert!(matches!(error, DatabaseError::Content { .. }), "{error}");
        }
    }
    let mut short = bytes[..400].to_vec();
    short.extend([0; 4]);
    reseal(&mut short);
    assert!(matches!(Database::from_bytes(&short), Err(DatabaseError::Content { .. })));
}

fn reseal(bytes: &mut [u8]) {
    let end = bytes.len() - 4;
    let sum = crc32fast::hash(&bytes[..end]);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
}
