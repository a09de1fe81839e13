//! All errors in files of shapes, with their fixes.
//!
//! One variant per reason; the text is the reason with its place in the file, [`SolidError::fix`] says what
//! to do. Triangles are numbered from 1.

use metamorph_core::lattice::Cell;
use thiserror::Error;

/// Bytes of a shape file at most: two million triangles in a binary STL.
pub const MAX_BYTES: u64 = 128 << 20;
/// Largest number of triangles of one file.
pub const MAX_TRIANGLES: usize = 2_000_000;
/// Cells of the box around a mesh at most.
pub const MAX_GRID: u64 = 16_000_000;
/// Cells of the box around an imported shape at most.
pub const MAX_BOX: u64 = 64_000_000;
/// The maximum work to convert a mesh: pairs of a triangle and a column of cells that it may cross, samples of the surface,
/// and eight for each pair of a cell and a piece of the mesh's rim.
pub const MAX_WORK: u64 = 400_000_000;
/// Largest number of edges of a mesh at which it is not closed.
pub const MAX_RIM: usize = 1_000_000;
/// Largest number of elements, texts and comments of an XML file.
pub const MAX_NODES: u32 = 2_000_000;
/// Largest number of attributes of an XML file.
pub const MAX_ATTRIBUTES: usize = 2_000_000;
/// Largest number of attributes of one element. The parser compares each pair.
pub const MAX_ATTRIBUTES_OF_ONE: usize = 64;
/// Largest number of namespaces that an XML file may declare. The parser lists them for every element.
pub const MAX_NAMESPACES: usize = 16;
/// Largest number of solids that the text of a solid joins, motions among them.
pub const MAX_CSG_PARTS: usize = 10_000;
/// Largest number of solids and parentheses around one another in the text of a solid.
pub const MAX_CSG_DEPTH: usize = 64;
/// Largest number of voxels of a MagicaVoxel scene, those of a model counted as often as it is in the scene, and of
/// cells that a configuration names.
pub const MAX_VOXELS: usize = 4_000_000;
/// Largest number of chunks of a MagicaVoxel file, and of nodes of its scene that are examined.
pub const MAX_VOX_CHUNKS: usize = 100_000;
/// Bytes of a MagicaVoxel file at most that hold no voxels. In memory they take a multiple of that.
pub const MAX_VOX_SCENE: usize = 8 << 20;

/// An error in a file.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SolidError {
    /// It cannot be opened or read.
    #[error("{file}: cannot read it: {why}")]
    Unreadable {
        /// The file.
        file: String,
        /// The cause.
        why: String,
    },
    /// A directory, a pipe or a device.
    #[error("{0}: not a regular file")]
    NoFile(String),
    /// Too many parts of one kind.
    #[error("{file}:{line}: there are more than {most} {what}")]
    TooManyParts {
        /// The file.
        file: String,
        /// The line of the first excess part.
        line: usize,
        /// The kind of part.
        what: &'static str,
        /// The maximum.
        most: usize,
    },
    /// Too many bytes.
    #[error("{file}: the file is larger than {} MiB", MAX_BYTES >> 20, file = .0)]
    TooLarge(String),
    /// Neither a mesh nor a configuration, by its name.
    #[error("{0}: the name does not end in .stl, .obj, .vox, .xml or .toml")]
    Format(String),
    /// Content of another kind than the name says.
    #[error("{file}: this is {what}")]
    Foreign {
        /// The file.
        file: String,
        /// The kind of content.
        what: &'static str,
        /// How to get the shape instead.
        instead: &'static str,
    },
    /// Shorter than any STL.
    #[error(
        "{file}: the file has {bytes} bytes; an STL begins with 84 bytes, or is text that begins with `solid`"
    )]
    TooShort {
        /// The file.
        file: String,
        /// Its length.
        bytes: usize,
    },
    /// A binary STL that ends too early.
    #[error(
        "{file}: the file ends in triangle {} of {expected} (byte {bytes})", found + 1
    )]
    Truncated {
        /// The file.
        file: String,
        /// Complete triangles present.
        found: u64,
        /// Triangles that its header promises.
        expected: u64,
        /// Its length.
        bytes: u64,
    },
    /// Text that violates its format.
    #[error("{file}:{line}: {why}")]
    Syntax {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// The cause.
        why: String,
    },
    /// A coordinate that is not a finite number.
    #[error("{file}: a corner of triangle {triangle} is not a finite number")]
    NotFinite {
        /// The file.
        file: String,
        /// The triangle.
        triangle: usize,
    },
    /// No triangle.
    #[error("{0}: there is no triangle in it")]
    Empty(String),
    /// More triangles than [`MAX_TRIANGLES`].
    #[error("{file}: the mesh has {found} triangles; {MAX_TRIANGLES} is the maximum")]
    TooManyTriangles {
        /// The file.
        file: String,
        /// The number of triangles, as far as known.
        found: u64,
    },
    /// Edges of one triangle only, or of triangles that do not fit: the mesh has holes.
    #[error(
        "{file}: the mesh is not closed: {edges} edges {how}, such as the one {ends} of triangle {triangle}; {why}"
    )]
    Open {
        /// The file.
        file: String,
        /// The number of such edges.
        edges: usize,
        /// How their triangles belong to them.
        how: &'static str,
        /// The ends of an example.
        ends: String,
        /// Its triangle.
        triangle: usize,
        /// Why the inside cannot be told all the same.
        why: String,
    },
    /// The pitch of a mesh is missing.
    #[error("{0}: a mesh needs a `pitch`, the edge of a cell in the units of the file")]
    NoPitch(String),
    /// An invalid pitch.
    #[error("the pitch is {0}; it must be a number above 0")]
    Pitch(String),
    /// Too many cells.
    #[error(
        "{file}: with a pitch of {pitch} the box around the mesh has {x} x {y} x {z} cells; {MAX_GRID} in all is the maximum"
    )]
    TooFine {
        /// The file.
        file: String,
        /// The pitch.
        pitch: String,
        /// Cells along x.
        x: u64,
        /// Cells along y.
        y: u64,
        /// Cells along z.
        z: u64,
    },
    /// Triangles that cover too many cells together.
    #[error(
        "{0}: its triangles overlap, or its edges are open, so often that filling the cells would take too long"
    )]
    TooMuchWork(String),
    /// The solid contains no centre of a cell.
    #[error("{file}: no cell has its middle inside the solid, whose size is {size}; the pitch is {pitch}")]
    Vanished {
        /// The file.
        file: String,
        /// Its extent.
        size: String,
        /// The pitch.
        pitch: String,
    },
    /// Parts thinner than a cell.
    #[error(
        "{file}: it is thinner than a cell, which is {pitch}, in {samples} of {of} samples of its surface, such as at {at}"
    )]
    Thin {
        /// The file.
        file: String,
        /// The pitch.
        pitch: String,
        /// Samples without a filled cell.
        samples: u64,
        /// Samples in all.
        of: u64,
        /// A sample without a filled cell, in the units of the file.
        at: String,
    },
    /// A coordinate out of range.
    #[error("{file}: a cell at [{}, {}, {}] is out of range; coordinates go from -{limit} to {limit}", cell[0], cell[1], cell[2], limit = Cell::LIMIT)]
    OutOfRange {
        /// The file.
        file: String,
        /// The cell.
        cell: [i64; 3],
    },
    /// Cells too far apart.
    #[error("{file}: the box around its cells has {cells} cells; {MAX_BOX} is the maximum")]
    TooWide {
        /// The file.
        file: String,
        /// Cells of the box.
        cells: u64,
    },
    /// A document type, which could contain entities that expand without bounds.
    #[error(
        "{file}:{line}: the file declares a document type, which is refused because entities could be hidden in it"
    )]
    Doctype {
        /// The file.
        file: String,
        /// The line.
        line: u32,
    },
    /// The configuration lacks the requested part.
    #[error("{file}: the configuration has no {what}")]
    NoPart {
        /// The file.
        file: String,
        /// The part.
        what: &'static str,
    },
    /// The requested part is there but empty.
    #[error("{file}:{line}: {what}")]
    EmptyPart {
        /// The file.
        file: String,
        /// The line of the part.
        line: u32,
        /// The part and what it lacks.
        what: String,
    },
    /// An obstacle where the shape has a cell.
    #[error("{file}:{line}: <obstacleList> has an obstacle in the cell {cell}, which the shape has, too")]
    Obstacle {
        /// The file.
        file: String,
        /// The line.
        line: u32,
        /// The cell.
        cell: Cell,
    },
    /// A known element that is not supported.
    #[error("{file}:{line}: {what} is not supported")]
    NotRead {
        /// The file.
        file: String,
        /// The line.
        line: u32,
        /// The element.
        what: String,
    },
    /// A binary file that violates its format.
    #[error("{file}: {place}: {why}")]
    Damaged {
        /// The file.
        file: String,
        /// The byte or part.
        place: String,
        /// The cause.
        why: String,
    },
    /// More of something than is read.
    #[error("{file}: there are more than {most} {what}")]
    TooMuch {
        /// The file.
        file: String,
        /// The kind of part.
        what: &'static str,
        /// The maximum.
        most: usize,
    },
    /// A scene without a visible voxel.
    #[error("{0}: there is no voxel in it that is shown")]
    NoVoxel(String),
    /// An option for another kind of file.
    #[error("{file}: `{option}` does not apply to {what}")]
    Option {
        /// The file.
        file: String,
        /// The option.
        option: &'static str,
        /// The kind of file.
        what: &'static str,
    },
}

impl SolidError {
    /// Returns what to do about it.
    pub fn fix(&self) -> &'static str {
        match self {
            SolidError::Unreadable { .. } | SolidError::NoFile(_) => {
                "check the path (paths in a scenario are relative to its file) and its permissions"
            }
            SolidError::TooLarge(_) | SolidError::TooManyTriangles { .. } => {
                "reduce the mesh, for example with Blender's Decimate modifier; cells are coarse anyway"
            }
            SolidError::Format(_) => {
                "export it as STL, OBJ or VOX, or name a configuration of VisibleSim or a drawing"
            }
            SolidError::Foreign { instead, .. } => instead,
            SolidError::TooShort { .. } | SolidError::Truncated { .. } | SolidError::Damaged { .. } => {
                "export or copy the file again"
            }
            SolidError::TooMuch { .. } => "export a part of it",
            SolidError::NoVoxel(_) => "show a layer or model that has voxels, and export the file again",
            SolidError::Syntax { .. } | SolidError::NotFinite { .. } => {
                "export the file again, or repair this place"
            }
            SolidError::Empty(_) => "export a solid with its surface as triangles",
            SolidError::Open { .. } => {
                "close the holes, for example with \"make manifold\" of Blender's 3D-print toolbox"
            }
            SolidError::NoPitch(_) => "write for example `pitch = 10`",
            SolidError::Pitch(_) => {
                "write the edge of a cell in the units of the file, for example `pitch = 10`"
            }
            SolidError::TooManyParts { .. } => "export it as one solid, and leave out what is not its shape",
            SolidError::TooFine { .. } => "choose a larger pitch",
            SolidError::TooMuchWork(_) => "reduce the mesh, or choose a larger pitch",
            SolidError::Vanished { .. } => "choose a smaller pitch",
            SolidError::Thin { .. } => {
                "choose a smaller pitch, make it thicker there, or write `thin = \"drop\"` to do without those parts"
            }
            SolidError::TooWide { .. } => "move the cells closer together",
            SolidError::OutOfRange { .. } => "move it towards the origin",
            SolidError::Doctype { .. } => "remove the declaration; configurations of VisibleSim need none",
            SolidError::NoPart { .. } | SolidError::EmptyPart { .. } => {
                "name the other part, or add it to the configuration"
            }
            SolidError::Obstacle { .. } => "remove the obstacle, or the cell from the shape",
            SolidError::NotRead { .. } => {
                "name every cell with its position, as the values of a line, or in a box; a solid can be read from its own file (.stl, .obj)"
            }
            SolidError::Option { .. } => "leave it out",
        }
    }
}
