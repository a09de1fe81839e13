//! A bounded search for an exact cover: every cell in exactly one of the chosen pieces.
//!
//! The cell that the fewest pieces can still cover is covered next, as in Knuth's algorithm X. The piece is chosen in
//! the order of the pieces, so that the same input gives the same answer.

use super::Going;

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cover {
    /// The pieces, ascending.
    Found(Vec<usize>),
    /// There is no cover.
    None,
    /// The limit came first.
    Undecided,
}

/// The state of a search. `N` cells make a piece.
struct Search<'a, const N: usize> {
    pieces: &'a [[u32; N]],
    /// The pieces of each cell.
    of: Vec<Vec<u32>>,
    /// How many chosen pieces share a cell with each piece.
    blocked: Vec<u32>,
    /// How many pieces can still cover each cell.
    open: Vec<u32>,
    covered: Vec<bool>,
    chosen: Vec<u32>,
    /// Choices that may still be tried.
    left: u64,
    going: Going<'a>,
}

/// Searches for a cover of `cells` cells. `limit` is the number of choices that it tries, and `going` is asked before
/// each whether to continue.
pub fn cover<const N: usize>(cells: usize, pieces: &[[u32; N]], limit: u64, going: Going<'_>) -> Cover {
    let mut of = vec![Vec::new(); cells];
    for (i, piece) in pieces.iter().enumerate() {
        for cell in piece {
            of[*cell as usize].push(i as u32);
        }
    }
    let open = of.iter().map(|p: &Vec<u32>| p.len() as u32).collect();
    let (blocked, covered) = (vec![0; pieces.len()], vec![false; cells]);
    let mut search = Search { pieces, of, blocked, open, covered, chosen: Vec::new(), left: limit, going };
    match search.run() {
        Some(true) => {
            let mut chosen: Vec<usize> = search.chosen.iter().map(|p| *p as usize).collect();
            chosen.sort_unstable();
            Cover::Found(chosen)
        }
        Some(false) => Cover::None,
        None => Cover::Undecided,
    }
}

impl<const N: usize> Search<'_, N> {
    /// Returns whether a cover was found, or `None` at the limit.
    fn run(&mut self) -> Option<bool> {
        let uncovered = (0..self.covered.len()).filter(|c| !self.covered[*c]);
        let Some(cell) = uncovered.min_by_key(|c| self.open[*c]) else { return Some(true) };
        for i in 0..self.of[cell].len() {
            let piece = self.of[cell][i];
            if self.blocked[piece as usize] > 0 {
                continue;
            }
            self.left = self.left.checked_sub(1).filter(|_| (self.going)())?;
            self.choose(piece, true);
            if self.run()? {
                return Some(true);
            }
            self.choose(piece, false);
        }
        Some(false)
    }

    /// Chooses a piece, or takes the last choice back.
    fn choose(&mut self, piece: u32, chosen: bool) {
        if chosen {
            self.chosen.push(piece);
        } else {
            self.chosen.pop();
        }
        for cell in self.pieces[piece as usize] {
            self.covered[cell as usize] = chosen;
            for other in &self.of[cell as usize] {
                let blocked = &mut self.blocked[*other as usize];
                let before = *blocked;
                *blocked = if chosen { before + 1 } else { before - 1 };
                if before.min(*blocked) == 0 {
                    for near in self.pieces[*other as usize] {
                        let open = &mut self.open[near as usize];
                        *open = if chosen { *open - 1 } else { *open + 1 };
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covers_are_found_refuted_and_given_up() {
        let pieces = [[0, 1], [1, 2], [2, 3]];
        assert_eq!(cover(4, &pieces, 100, &|| true), Cover::Found(vec![0, 2]));
        assert_eq!(cover(3, &pieces[..2], 100, &|| true), Cover::None);
        assert_eq!(cover(4, &pieces, 1, &|| true), Cover::Undecided);
    }
}
