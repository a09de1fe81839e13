//! A maximum matching of cells, kept by alternating searches.
//!
//! An alternating search goes from a cell without a partner along free and paired edges in turn to another one
//! without a partner, and exchanges the edges of the path. No loop here recurses: a path may be as long as the
//! structure.

use super::{NONE, Surroundings, is_even};
use metamorph_core::lattice::Face;

/// A matching of the present cells.
#[derive(Clone, Debug)]
pub struct Matching {
    present: Vec<bool>,
    mate: Vec<u32>,
    /// The order in which neighbours are tried.
    faces: [Face; 6],
    /// The number of marks with which a cell at an odd distance was last seen.
    seen: Vec<u32>,
    /// By colour of the cell that a search starts from, the number of the marks that hold. Searches from cells of one colour
    /// mark cells of the other.
    marks: [u32; 2],
    /// The cell before one at an odd distance.
    before: Vec<u32>,
    queue: Vec<u32>,
}

impl Matching {
    /// The drawn cells, without a pair.
    pub fn new(around: &Surroundings) -> Matching {
        let n = around.cells.len();
        Matching {
            present: around.drawn.clone(),
            mate: vec![NONE; n],
            faces: Face::ALL,
            seen: vec![0; n],
            marks: [0; 2],
            before: vec![NONE; n],
            queue: Vec::new(),
        }
    }
    /// The partner of each cell, or [`NONE`].
    pub fn mates(&self) -> &[u32] {
        &self.mate
    }
    /// Whether each cell is there.
    pub fn present(&self) -> &[bool] {
        &self.present
    }
    /// Returns the present cells without a partner.
    pub fn unpaired(&self) -> impl Iterator<Item = u32> + '_ {
        let cells = self.present.iter().zip(&self.mate).enumerate();
        cells.filter(|(_, (present, mate))| **present && **mate == NONE).map(|(i, _)| i as u32)
    }

    /// Makes the matching a maximum one. Cells are taken in this order, by default ascending; neighbours in the
    /// order of `faces`.
    pub fn complete(&mut self, around: &Surroundings, faces: [Face; 6], order: Option<&[u32]>) {
        self.faces = faces;
        let ascending: Vec<u32>;
        let order = match order {
            Some(order) => order,
            None => {
                ascending = (0..self.mate.len() as u32).collect();
                &ascending
            }
        };
        for cell in order.iter().copied().filter(|c| self.present[*c as usize]) {
            if self.mate[cell as usize] == NONE {
                let partner = self.neighbours(around, cell).find(|n| self.mate[*n as usize] == NONE);
                if let Some(partner) = partner {
                    (self.mate[cell as usize], self.mate[partner as usize]) = (partner, cell);
                }
            }
        }
        // A path of exchange has one even and one odd end. The marks of a pass are kept within it, so that a pass
        // examines every edge once; the last pass, which finds nothing, is a complete search.
        loop {
            self.forget();
            let mut found = false;
            for cell in order.iter().copied() {
                let open = self.present[cell as usize] && self.mate[cell as usize] == NONE;
                if open && is_even(around.cells[cell as usize]) {
                    found |= self.search(around, cell);
                }
            }
            if !found {
                return;
            }
        }
    }

    fn neighbours<'a>(&'a self, around: &'a Surroundings, cell: u32) -> impl Iterator<Item = u32> + 'a {
        let neighbours = around.choices(cell);
        let all = self.faces.iter().map(move |f| neighbours[f.index()]);
        all.filter(move |n| *n != NONE && self.present[*n as usize])
    }
    /// Pairs two neighbours, if both are present and have no partner.
    pub fn pair(&mut self, around: &Surroundings, a: u32, b: u32) {
        let [i, j] = [a as usize, b as usize];
        let open = |k: usize| self.present[k] && self.mate[k] == NONE;
        if open(i) && open(j) && around.choices(a).contains(&b) {
            (self.mate[i], self.mate[j]) = (b, a);
        }
    }

    /// Drops the marks of earlier searches.
    pub fn forget(&mut self) {
        self.marks = self.marks.map(|number| number + 1);
    }

    /// Drops the marks that do not hold any more after a search from a cell that was added, or whose partner was
    /// removed: its own, and all of searches from cells of the other colour, which may continue at that cell. Where
    /// searches from this colour ended without success, they still do: a path that enters there cannot leave.
    fn forget_found(&mut self, around: &Surroundings, from: u32) {
        // Invariant: all cells of the queue have partners now, and those were seen.
        for even in &self.queue {
            self.seen[self.mate[*even as usize] as usize] = 0;
        }
        self.marks[usize::from(!is_even(around.cells[from as usize]))] += 1;
    }

    /// Searches from a cell without a partner for another one, and pairs along the path. Cells that an earlier
    /// search has seen since [`Matching::forget`] are passed over.
    pub fn search(&mut self, around: &Surroundings, from: u32) -> bool {
        self.search_within(around, from, |_| true)
    }

    /// Searches as [`Matching::search`] does, for a path whose cells at an odd distance are `within`.
    fn search_within(&mut self, around: &Surroundings, from: u32, within: impl Fn(u32) -> bool) -> bool {
        let mut queue = std::mem::take(&mut self.queue);
        queue.clear();
        queue.push(from);
        let marks = self.marks[usize::from(is_even(around.cells[from as usize]))];
        let mut next = 0;
        let mut end = None;
        'paths: while let Some(cell) = queue.get(next).copied() {
            next += 1;
            for face in self.faces {
                let near = around.choices(cell)[face.index()];
                if near == NONE || !self.present[near as usize] || self.seen[near as usize] == marks {
                    continue;
                }
                if !within(near) {
                    continue;
                }
                self.seen[near as usize] = marks;
                self.before[near as usize] = cell;
                match self.mate[near as usize] {
                    NONE => {
                        end = Some(near);
                        break 'paths;
                    }
                    mate => queue.push(mate),
                }
            }
        }
        self.queue = queue;
        let found = end.is_some();
        while let Some(odd) = end {
            let even = self.before[odd as usize];
            let former = self.mate[even as usize];
            (self.mate[even as usize], self.mate[odd as usize]) = (odd, even);
            end = (former != NONE).then_some(former);
        }
        found
    }

    /// Returns for each cell whether some maximum matching leaves it over: those at an even distance from a cell
    /// without a partner along alternating paths (Gallai and Edmonds). The matching must be a maximum one.
    pub fn free(&self, around: &Surroundings) -> Vec<bool> {
        let mut free = vec![false; self.mate.len()];
        let mut queue: Vec<u32> = self.unpaired().collect();
        for cell in &queue {
            free[*cell as usize] = true;
        }
        while let Some(cell) = queue.pop() {
            for near in self.neighbours(around, cell) {
                let mate = self.mate[near as usize];
                if mate != NONE && !free[mate as usize] {
                    free[mate as usize] = true;
                    queue.push(mate);
                }
            }
        }
        free
    }

    /// Adds a cell if that leaves one cell less over; returns whether it did. Marks of earlier additions and removals are
    /// kept as far as they hold. Cells that are not `free`, neither now nor before earlier changes, may not be left over, so that
    /// no path leads over them.
    pub fn add(&mut self, around: &Surroundings, cell: u32, free: &[bool]) -> bool {
        let useful =
            !self.present[cell as usize] && self.search_within(around, cell, |near| free[near as usize]);
        if useful {
            self.present[cell as usize] = true;
            self.forget_found(around, cell);
        }
        useful
    }
    /// Removes a cell if that leaves one cell less over; returns whether it did. Marks are kept, and paths limited, as by
    /// [`Matching::add`].
    pub fn remove(&mut self, around: &Surroundings, cell: u32, free: &[bool]) -> bool {
        if !self.present[cell as usize] {
            return false;
        }
        let mate = std::mem::replace(&mut self.mate[cell as usize], NONE);
        self.present[cell as usize] = false;
        if mate == NONE {
            self.forget();
            return true;
        }
        self.mate[mate as usize] = NONE;
        let useful = self.search_within(around, mate, |near| free[near as usize]);
        if useful {
            self.forget_found(around, mate);
        } else {
            (self.mate[cell as usize], self.mate[mate as usize]) = (mate, cell);
            self.present[cell as usize] = true;
        }
        useful
    }
    /// Takes two neighbours out of a maximum matching as one pair, if the others then have as many pairs as there are
    /// without it; returns whether it did. If not, the matching is a maximum one again.
    pub fn pin(&mut self, around: &Surroundings, a: u32, b: u32) -> bool {
        // Two cells go away and one pair with them; it costs nothing if as many cells as before are left over.
        let kept = self.take_out(around, a) + self.take_out(around, b) == 0;
        if !kept {
            for cell in [a, b] {
                self.present[cell as usize] = true;
                self.forget();
                self.search(around, cell);
            }
        }
        kept
    }
    /// Removes a cell and finds another partner for the one it had, if there is one. Returns by how many the cells left
    /// over have become more.
    fn take_out(&mut self, around: &Surroundings, cell: u32) -> i32 {
        self.present[cell as usize] = false;
        let mate = std::mem::replace(&mut self.mate[cell as usize], NONE);
        if mate == NONE {
            return -1;
        }
        self.mate[mate as usize] = NONE;
        self.forget();
        // The cell that has lost its partner is left over, or takes another one that was along.
        if self.search(around, mate) { -1 } else { 1 }
    }
    /// Adds or removes a cell. The matching has to be completed afterwards.
    pub fn toggle(&mut self, cell: u32) {
        let mate = std::mem::replace(&mut self.mate[cell as usize], NONE);
        if mate != NONE {
            self.mate[mate as usize] = NONE;
        }
        self.present[cell as usize] ^= true;
    }
}
