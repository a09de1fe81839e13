//! Structures whose joints are at lattice angles, from and to the configurations of central planning.

use super::structure::{Connection, Structure};
use metamorph_core::ids::ModuleId;
use metamorph_planning::assembly::configuration::{Configuration, MAX_MODULES, Module};
use metamorph_planning::assembly::tables::{STEP, TABLES, add, sub};
use metamorph_roombots::connector::Connector;

/// Returns the configuration of a structure with these posture codes, by the number of the module; module 0 is at the
/// origin. Whether rings close and cells are free is not checked; see [`super::geometry::place`]. `None` if there are
/// more modules than a configuration has, or one was removed.
pub fn configuration(structure: &Structure, postures: &[u8]) -> Option<Configuration> {
    let n = structure.bound();
    if n > MAX_MODULES || postures.len() != n || structure.modules().count() != n {
        return None;
    }
    let mut placed: Vec<Option<Module>> = vec![None; n];
    placed[0] = Some(Module { posture: postures[0], ..Module::default() });
    let mut reached = vec![0];
    while let Some(module) = reached.pop() {
        let Some(from) = placed[module] else { continue };
        let ends = structure.connections().iter().flat_map(|c| [*c, c.reversed()]);
        for c in ends.filter(|c| c.a.index() == module) {
            let to = c.b.index();
            if placed[to].is_none() {
                placed[to] = Some(beyond(&from, &c, postures[to]));
                reached.push(to);
            }
        }
    }
    let mut modules: Vec<Module> = placed.into_iter().collect::<Option<_>>()?;
    for (module, connector) in structure.connections().iter().flat_map(Connection::ends) {
        modules[module.index()].held |= 1 << connector as u16;
    }
    Configuration::new(&modules)
}

/// Returns the module behind a connection.
fn beyond(from: &Module, c: &Connection, posture: u8) -> Module {
    let t = &**TABLES;
    let at = from.connector_frame(c.at as u8);
    let across = (0..c.rotation).fold(t.flip, |r, _| t.times(r, t.quarter));
    let own = t.connector[usize::from(posture)][c.to as usize];
    let rotation = t.times(t.times(at, across), t.inverse[usize::from(own)]);
    let touched = add(from.cells()[c.at.hemisphere() / 2], STEP[usize::from(from.face_of(c.at as u8))]);
    let module = Module { cell: touched, rotation, posture, held: 0 };
    match c.to.hemisphere() / 2 {
        0 => module,
        _ => Module { cell: sub(touched, STEP[usize::from(module.direction())]), ..module },
    }
}

/// Returns the structure of a configuration; `None` if it is not connected.
pub fn structure(configuration: &Configuration) -> Option<Structure> {
    let t = &**TABLES;
    let modules = configuration.modules();
    let connection = |pair: metamorph_planning::assembly::configuration::Pair| {
        let [(a, at), (b, to)] = [pair.a, pair.b];
        let [from, onto] = [(a, at), (b, to)].map(|(m, c)| modules[usize::from(m)].connector_frame(c));
        let turn = |k: &u8| t.times(from, (0..*k).fold(t.flip, |r, _| t.times(r, t.quarter))) == onto;
        let [at, to] = [at, to].map(|c| Connector::ALL[usize::from(c)]);
        // Invariant: connectors that face each other differ by quarter turns.
        let rotation = (0..4).find(turn)?;
        Some(Connection { a: ModuleId(a.into()), at, b: ModuleId(b.into()), to, rotation })
    };
    let connections: Vec<Connection> =
        configuration.connections().into_iter().map(connection).collect::<Option<_>>()?;
    Structure::new(modules.len(), &connections).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_module::geometry::place;
    use crate::free_module::named;
    use metamorph_core::rng::Rng;
    use metamorph_roombots::Kind;
    use metamorph_roombots::posture::Posture;
    use nalgebra::Vector3;

    /// Integers and floating point place modules alike, and the structure comes back.
    #[test]
    fn lattice_and_space_agree() {
        let mut rng = Rng::named(1, "postures", 0);
        let mut compared = 0;
        for round in 0..200 {
            let name = ["quad5-sym", "quad5-unsym", "quad9", "tripod4"][round % 4];
            let tree = named::structure(name).unwrap();
            let postures: Vec<u8> = (0..tree.bound()).map(|_| rng.below(36) as u8).collect();
            let degrees = |code: &u8| {
                let steps = [code / 12, code / 3 % 4, code % 3];
                let all = Posture::from_steps(Kind::Single, &steps).unwrap().degrees();
                [f64::from(all[0]), f64::from(all[1]), f64::from(all[2])]
            };
            let Ok(poses) = place(&tree, &postures.iter().map(degrees).collect::<Vec<_>>()) else { continue };
            compared += 1;
            let found = configuration(&tree, &postures).unwrap();
            for (module, pose) in found.modules().iter().zip(poses.values()) {
                let rotation = TABLES.rotations[usize::from(module.rotation)].matrix();
                assert!((rotation - pose.rotation).amax() < 1e-9, "{name} {postures:?}");
                let centre = pose.origin + pose.rotation.column(2) * 0.5;
                // The cell (x, y, l) has its centre at (x, y, l + 1/2).
                let cell = module.cell.map(f64::from);
                let expected = Vector3::new(cell[0], cell[1], cell[2] + 0.5);
                assert!((centre - expected).amax() < 1e-9, "{name} {postures:?}");
            }
            assert_eq!(structure(&found).unwrap(), tree, "{name} {postures:?}");
        }
        assert!(compared > 50, "{compared}");
    }
}
