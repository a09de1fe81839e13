//! Scenes of MagicaVoxel (.vox): the voxels of all models that are shown, where the scene puts them. z is up, as here.
//!
//! A part that cannot be read is an error, and `File::read` bounds the rest. Ignored: colours, materials, cameras. Of an
//! animation, the first frame counts.

use super::error::{MAX_VOX_CHUNKS, MAX_VOX_SCENE, MAX_VOXELS, SolidError};
use super::visiblesim::in_range;
use metamorph_core::lattice::Cell;
use std::collections::{BTreeMap, BTreeSet};

/// Bytes before the first chunk: the name of the format and its version.
const HEADER: usize = 8;
/// Bytes of a chunk before its content: its name, and the lengths of its content and of the chunks in it.
const CHUNK: usize = 12;

/// Name of the count of a scene's nodes, in errors.
const NODES: &str = "nodes, each counted as often as it is used";

/// Counts of the content of a file's chunks.
#[derive(Debug, Default, PartialEq, Eq)]
struct Counts {
    models: usize,
    nodes: usize,
    layers: usize,
    /// Voxels of all models.
    voxels: usize,
    /// Bytes of chunks that hold no voxels.
    scene: usize,
}

/// A signed permutation of the axes, and a translation.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// The axis and sign of each coordinate of the image.
    rows: [(usize, i64); 3],
    by: [i64; 3],
}

/// Attributes of a node, of a frame or of a layer.
type Attributes<'a> = BTreeMap<&'a str, &'a str>;

/// A model: the lengths of its sides, and of each voxel its place and its colour.
#[derive(Debug)]
struct Model<'a> {
    size: [u32; 3],
    voxels: &'a [[u8; 4]],
}

/// A node of the scene. Others are named by their number.
#[derive(Debug)]
enum Node<'a> {
    /// Moves its child; of an animation, as in the first frame.
    Transform { is_hidden: bool, child: u32, layer: u32, frame: Option<Attributes<'a>> },
    /// Holds children.
    Group(Vec<u32>),
    /// Shows a model; of an animation, the first.
    Shape(Option<u32>),
}

/// The parts of a file that say which cells are filled.
#[derive(Debug, Default)]
struct File<'a> {
    models: Vec<Model<'a>>,
    nodes: Vec<Node<'a>>,
    /// Whether each layer is hidden.
    layers: Vec<bool>,
}

/// Reads the cells of a scene.
pub fn cells(name: &str, bytes: &[u8]) -> Result<BTreeSet<Cell>, SolidError> {
    let file = File::read(name, bytes)?;
    let mut scene = Scene { name, file: &file, cells: BTreeSet::new(), left: MAX_VOXELS };
    if file.nodes.is_empty() {
        // Older files have models only; several are the frames of an animation.
        if let Some(model) = file.models.first() {
            scene.put(model, Motion::none(), false)?;
        }
    } else {
        scene.walk()?;
    }
    if scene.cells.is_empty() {
        return Err(SolidError::NoVoxel(name.to_owned()));
    }
    Ok(scene.cells)
}

fn damaged(file: &str, place: String, why: &str) -> SolidError {
    SolidError::Damaged { file: file.to_owned(), place, why: why.to_owned() }
}

impl<'a> File<'a> {
    /// Reads the chunks of a file.
    fn read(name: &str, bytes: &'a [u8]) -> Result<File<'a>, SolidError> {
        let wrong = |at: usize, why: &str| damaged(name, format!("byte {at}"), why);
        let too_many = |what, most| SolidError::TooMuch { file: name.to_owned(), what, most };
        if !bytes.starts_with(b"VOX ") {
            return Err(wrong(0, "this is no MagicaVoxel file; one begins with `VOX `"));
        }
        let number = |at: usize| {
            let four = bytes.get(at..at.checked_add(4)?)?;
            Some(u32::from_le_bytes(four.try_into().ok()?) as usize)
        };
        // The name of a chunk, the place of its content, the lengths of content and of inner chunks.
        let chunk = |at: usize, end: usize| {
            let (content, inner) = (number(at + 4)?, number(at + 8)?);
            let length = CHUNK.checked_add(content)?.checked_add(inner)?;
            (length <= end.checked_sub(at)?).then(|| (&bytes[at..at + 4], at + CHUNK, content, inner))
        };
        let early = "the file ends in the chunk that begins here";
        let main = chunk(HEADER, bytes.len()).ok_or_else(|| wrong(HEADER, early))?;
        let (b"MAIN", at, content, inner) = main else {
            return Err(wrong(HEADER, "the first chunk is not `MAIN`"));
        };
        let (mut at, end) = (at + content, at + content + inner);
        let (mut file, mut counts, mut chunks) = (File::default(), Counts::default(), 0);
        let mut size = None;
        while at < end {
            let (kind, from, content, inner) = chunk(at, end).ok_or_else(|| wrong(at, early))?;
            if inner > 0 {
                return Err(wrong(at, "chunks within a chunk other than `MAIN` are not read"));
            }
            if std::str::from_utf8(kind).is_err() {
                return Err(wrong(at, "no chunk has this name"));
            }
            chunks += 1;
            let first = number(from).filter(|_| content >= 4);
            match kind {
                b"XYZI" => {
                    counts.models += 1;
                    counts.voxels += first.unwrap_or(0).min(content / 4);
                }
                b"nTRN" | b"nGRP" | b"nSHP" => {
                    if first != Some(counts.nodes) {
                        return Err(wrong(at, "the nodes of the scene are not in ascending order"));
                    }
                    counts.nodes += 1;
                }
                b"LAYR" => {
                    if first != Some(counts.layers) {
                        return Err(wrong(at, "the layers of the scene are not in ascending order"));
                    }
                    counts.layers += 1;
                }
                _ => {}
            }
            counts.scene += if kind == b"XYZI" { 0 } else { content };
            if chunks > MAX_VOX_CHUNKS {
                return Err(too_many("chunks", MAX_VOX_CHUNKS));
            }
            if counts.voxels > MAX_VOXELS {
                return Err(too_many("voxels", MAX_VOXELS));
            }
            if counts.scene > MAX_VOX_SCENE {
                return Err(too_many("bytes that describe the scene", MAX_VOX_SCENE));
            }
            file.take(kind, Content(&bytes[from..from + content]), &mut size);
            at = from + content;
        }
        let damaged = |why| damaged(name, "a chunk".to_owned(), why);
        if file.models.len() != counts.models {
            return Err(damaged("a model has no size, or fewer voxels than it says"));
        }
        if file.nodes.len() != counts.nodes || file.layers.len() != counts.layers {
            return Err(damaged("a part of the scene ends early"));
        }
        Ok(file)
    }

    /// Takes a chunk, unless it cannot be read. A model has the last size before it.
    fn take(&mut self, kind: &[u8], mut content: Content<'a>, size: &mut Option<[u32; 3]>) {
        match kind {
            b"SIZE" => *size = content.size().or(*size),
            b"XYZI" => self.models.extend(size.and_then(|size| content.model(size))),
            b"nTRN" => self.nodes.extend(content.transform()),
            b"nGRP" => self.nodes.extend(content.group()),
            b"nSHP" => self.nodes.extend(content.shape()),
            b"LAYR" => self.layers.extend(content.layer()),
            _ => {}
        }
    }
}

/// The content of a chunk that is not read yet.
struct Content<'a>(&'a [u8]);

impl<'a> Content<'a> {
    fn number(&mut self) -> Option<u32> {
        let (bytes, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(u32::from_le_bytes(*bytes))
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.number()? as usize;
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        std::str::from_utf8(bytes).ok()
    }

    /// Reads a list: how many there are, and each.
    fn list<T, L: FromIterator<T>>(&mut self, mut one: impl FnMut(&mut Self) -> Option<T>) -> Option<L> {
        let length = self.number()?;
        (0..length).map(|_| one(self)).collect()
    }

    fn attributes(&mut self) -> Option<Attributes<'a>> {
        self.list(|content| Some((content.text()?, content.text()?)))
    }

    fn size(&mut self) -> Option<[u32; 3]> {
        Some([self.number()?, self.number()?, self.number()?])
    }

    fn model(&mut self, size: [u32; 3]) -> Option<Model<'a>> {
        let count = self.number()? as usize;
        let (voxels, _) = self.0.as_chunks();
        Some(Model { size, voxels: voxels.get(..count)? })
    }

    fn transform(&mut self) -> Option<Node<'a>> {
        let (_id, own) = (self.number()?, self.attributes()?);
        let (child, _reserved, layer) = (self.number()?, self.number()?, self.number()?);
        let frames: Vec<Attributes<'_>> = self.list(Self::attributes)?;
        let frame = frames.into_iter().next();
        Some(Node::Transform { is_hidden: is_hidden(&own), child, layer, frame })
    }

    fn group(&mut self) -> Option<Node<'a>> {
        let (_id, _own) = (self.number()?, self.attributes()?);
        self.list(Self::number).map(Node::Group)
    }

    fn shape(&mut self) -> Option<Node<'a>> {
        let (_id, _own) = (self.number()?, self.attributes()?);
        let models: Vec<u32> = self.list(|content| {
            let model = content.number()?;
            content.attributes().map(|_| model)
        })?;
        Some(Node::Shape(models.first().copied()))
    }

    fn layer(&mut self) -> Option<bool> {
        let (_id, own, _reserved) = (self.number()?, self.attributes()?, self.number()?);
        Some(is_hidden(&own))
    }
}

fn is_hidden(attributes: &Attributes<'_>) -> bool {
    attributes.get("_hidden") == Some(&"1")
}

/// A scene that is put together.
struct Scene<'a> {
    name: &'a str,
    file: &'a File<'a>,
    cells: BTreeSet<Cell>,
    /// Voxels that may still be put: a model may be in a scene many times.
    left: usize,
}

impl Scene<'_> {
    /// Puts all models that are shown. A node may be reached several times, so what is looked at is bounded.
    fn walk(&mut self) -> Result<(), SolidError> {
        let mut waiting: Vec<(u32, Motion)> = vec![(0, Motion::none())];
        let mut looked_at = 0;
        while let Some((id, motion)) = waiting.pop() {
            looked_at += 1;
            if looked_at > MAX_VOX_CHUNKS {
                return Err(self.too_much(NODES, MAX_VOX_CHUNKS));
            }
            let node = self.file.nodes.get(id as usize).ok_or_else(|| self.no_node(id))?;
            match node {
                Node::Transform { is_hidden, child, layer, frame } => {
                    if !is_hidden && self.file.layers.get(*layer as usize) != Some(&true) {
                        let own =
                            frame.as_ref().map_or(Ok(Motion::none()), |frame| self.motion(id, frame))?;
                        waiting.push((*child, motion.after(own)));
                    }
                }
                Node::Group(children) => {
                    if looked_at + waiting.len() + children.len() > MAX_VOX_CHUNKS {
                        return Err(self.too_much(NODES, MAX_VOX_CHUNKS));
                    }
                    waiting.extend(children.iter().map(|child| (*child, motion)));
                }
                Node::Shape(None) => {}
                Node::Shape(Some(model)) => {
                    let model = self.file.models.get(*model as usize);
                    let model = model.ok_or_else(|| self.node(id, "its model is not in the file"))?;
                    self.put(model, motion, true)?;
                }
            }
        }
        Ok(())
    }

    fn too_much(&self, what: &'static str, most: usize) -> SolidError {
        SolidError::TooMuch { file: self.name.to_owned(), what, most }
    }
    fn no_node(&self, id: u32) -> SolidError {
        self.node(id, "the scene names this node, which is not in the file")
    }
    fn node(&self, id: u32, why: &str) -> SolidError {
        damaged(self.name, format!("node {id} of the scene"), why)
    }

    fn motion(&self, id: u32, frame: &Attributes<'_>) -> Result<Motion, SolidError> {
        let mut motion = Motion::none();
        if let Some(text) = frame.get("_t") {
            let numbers: Option<Vec<i64>> =
                text.split_ascii_whitespace().map(|n| n.parse::<i32>().ok().map(i64::from)).collect();
            let by = numbers.and_then(|n| <[i64; 3]>::try_from(n).ok());
            motion.by = by.ok_or_else(|| self.node(id, "its translation is not three whole numbers"))?;
        }
        if let Some(text) = frame.get("_r") {
            let rows = text.trim().parse().ok().and_then(rows);
            motion.rows = rows.ok_or_else(|| self.node(id, "its rotation is none"))?;
        }
        Ok(motion)
    }

    /// Puts a model; one of a scene turns about its middle.
    fn put(&mut self, model: &Model<'_>, motion: Motion, about_middle: bool) -> Result<(), SolidError> {
        self.left =
            self.left.checked_sub(model.voxels.len()).ok_or_else(|| self.too_much("voxels", MAX_VOXELS))?;
        let size = model.size.map(i64::from);
        let middle = size.map(|side| if about_middle { side / 2 } else { 0 });
        for [x, y, z, _colour] in model.voxels {
            let at = [*x, *y, *z].map(i64::from);
            // Twice the place of the middle of the voxel, so that a turn keeps whole numbers: all are odd.
            let twice = [0, 1, 2].map(|axis| 2 * (at[axis] - middle[axis]) + 1);
            let moved = [0, 1, 2].map(|axis| {
                let (from, sign) = motion.rows[axis];
                (sign * twice[from] - 1) / 2 + motion.by[axis]
            });
            self.cells.insert(in_range(self.name, moved)?);
        }
        Ok(())
    }
}

/// Reads a rotation: the columns of the non-zero entries of the first two rows, and the signs of all three.
fn rows(byte: u8) -> Option<[(usize, i64); 3]> {
    let [first, second] = [usize::from(byte & 3), usize::from(byte >> 2 & 3)];
    let third = 3usize.checked_sub(first + second).filter(|_| first != second && first < 3 && second < 3)?;
    let sign = |bit: u8| if byte >> bit & 1 == 0 { 1 } else { -1 };
    Some([(first, sign(4)), (second, sign(5)), (third, sign(6))])
}

impl Motion {
    fn none() -> Motion {
        Motion { rows: [(0, 1), (1, 1), (2, 1)], by: [0; 3] }
    }
    /// Returns the motion that is the other one first and then this.
    fn after(self, first: Motion) -> Motion {
        let rows = self.rows.map(|(from, sign)| (first.rows[from].0, sign * first.rows[from].1));
        let by = [0, 1, 2].map(|axis| {
            let (from, sign) = self.rows[axis];
            sign * first.by[from] + self.by[axis]
        });
        Motion { rows, by }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        [name, &(content.len() as u32).to_le_bytes()[..], &0u32.to_le_bytes(), content].concat()
    }
    fn file(chunks: &[Vec<u8>]) -> Vec<u8> {
        let inner = chunks.concat();
        let main = [&b"MAIN"[..], &0u32.to_le_bytes(), &(inner.len() as u32).to_le_bytes(), &inner].concat();
        [&b"VOX "[..], &150u32.to_le_bytes(), &main].concat()
    }
    fn numbers(all: &[u32]) -> Vec<u8> {
        all.iter().flat_map(|n| n.to_le_bytes()).collect()
    }
    fn dict(entries: &[(&str, &str)]) -> Vec<u8> {
        let text = |s: &str| [&(s.len() as u32).to_le_bytes()[..], s.as_bytes()].concat();
        let listed = entries.iter().flat_map(|(key, value)| [text(key), text(value)]).flatten();
        numbers(&[entries.len() as u32]).into_iter().chain(listed).collect()
    }
    fn model(size: [u32; 3], voxels: &[[u8; 3]]) -> [Vec<u8>; 2] {
        let listed = voxels.iter().flat_map(|[x, y, z]| [*x, *y, *z, 7]);
        let listed = numbers(&[voxels.len() as u32]).into_iter().chain(listed).collect::<Vec<u8>>();
        [chunk(b"SIZE", &numbers(&size)), chunk(b"XYZI", &listed)]
    }
    fn transform(id: u32, child: u32, layer: u32, own: &[(&str, &str)], frame: &[(&str, &str)]) -> Vec<u8> {
        let content = [numbers(&[id]), dict(own), numbers(&[child, u32::MAX, layer, 1]), dict(frame)];
        chunk(b"nTRN", &content.concat())
    }
    fn group(id: u32, children: &[u32]) -> Vec<u8> {
        let content = [numbers(&[id]), dict(&[]), numbers(&[children.len() as u32]), numbers(children)];
        chunk(b"nGRP", &content.concat())
    }
    fn shape(id: u32, model: u32) -> Vec<u8> {
        chunk(b"nSHP", &[numbers(&[id]), dict(&[]), numbers(&[1, model]), dict(&[])].concat())
    }
    fn layer(id: u32, hidden: bool) -> Vec<u8> {
        let own = dict(if hidden { &[("_hidden", "1")] } else { &[] });
        chunk(b"LAYR", &[numbers(&[id]), own, numbers(&[u32::MAX])].concat())
    }
    fn read(chunks: &[Vec<u8>]) -> Result<Vec<[i16; 3]>, String> {
        let cells = cells("a.vox", &file(chunks)).map_err(|error| error.to_string())?;
        Ok(cells.into_iter().map(<[i16; 3]>::from).collect())
    }

    /// A corner of three cells in a box of 2 by 3 by 1.
    const CORNER: [[u8; 3]; 3] = [[0, 0, 0], [1, 0, 0], [0, 2, 0]];

    #[test]
    fn models_without_a_scene_are_read_as_they_are() {
        let [size, voxels] = model([2, 3, 1], &CORNER);
        let other = model([1, 1, 1], &[[0, 0, 0]]);
        let chunks = [vec![size, voxels], other.to_vec()].concat();
        assert_eq!(read(&chunks), Ok(vec![[0, 0, 0], [0, 2, 0], [1, 0, 0]]));
    }

    #[test]
    fn models_are_where_the_scene_puts_them() {
        let one = |frame: &[(&str, &str)]| {
            let [size, voxels] = model([2, 3, 1], &CORNER);
            read(&[size, voxels, transform(0, 1, 0, &[], frame), shape(1, 0)]).unwrap()
        };
        // The middle of the box is the corner of cells (1, 1, 0).
        assert_eq!(one(&[]), [[-1, -1, 0], [-1, 1, 0], [0, -1, 0]]);
        assert_eq!(one(&[("_t", "5 -2 3")]), [[4, -3, 3], [4, -1, 3], [5, -3, 3]]);
        // A quarter turn, x to y: the first row is -y, the second x.
        assert_eq!(one(&[("_r", "17")]), [[-2, -1, 0], [0, -1, 0], [0, 0, 0]]);
        // A mirror in x keeps the box, since it is as wide on both sides of its middle.
        assert_eq!(one(&[("_r", "20")]), [[-1, -1, 0], [0, -1, 0], [0, 1, 0]]);
    }

    #[test]
    fn groups_move_their_models_and_what_is_hidden_is_left_out() {
        let [size, voxels] = model([1, 1, 1], &[[0, 0, 0]]);
        let scene = |second: u32, own: &[(&str, &str)], hidden: bool| {
            read(&[
                size.clone(),
                voxels.clone(),
                transform(0, 1, u32::MAX, &[], &[("_r", "17"), ("_t", "0 0 9")]),
                group(1, &[2, second]),
                transform(2, 3, 0, &[], &[("_t", "4 0 0")]),
                shape(3, 0),
                transform(4, 5, 1, own, &[("_t", "0 6 0")]),
                shape(5, 0),
                layer(0, false),
                layer(1, hidden),
            ])
        };
        // Turned by a quarter: x is y, y is -x.
        assert_eq!(scene(4, &[], false), Ok(vec![[-7, 0, 9], [-1, 4, 9]]));
        assert_eq!(scene(4, &[("_hidden", "1")], false), Ok(vec![[-1, 4, 9]]));
        assert_eq!(scene(4, &[], true), Ok(vec![[-1, 4, 9]]));
        assert_eq!(scene(2, &[], false), Ok(vec![[-1, 4, 9]]));
        let circle = scene(0, &[], false).unwrap_err();
        assert!(circle.contains("more than 100000 nodes"), "{circle}");
        assert!(scene(6, &[], false).unwrap_err().contains("node 6 of the scene"));
    }

    #[test]
    fn damaged_files_are_refused_with_their_place() {
        let [size, voxels] = model([1, 1, 1], &[[0, 0, 0]]);
        let good = file(&[size.clone(), voxels.clone(), transform(0, 1, 0, &[], &[]), shape(1, 0)]);
        assert!(cells("a.vox", &good).is_ok());
        for cut in 0..good.len() {
            let error = cells("a.vox", &good[..cut]).unwrap_err().to_string();
            assert!(error.starts_with("a.vox: byte "), "{cut}: {error}");
        }
        let node = |frame: &[(&str, &str)]| {
            [size.clone(), voxels.clone(), transform(0, 1, 0, &[], frame), shape(1, 0)]
        };
        for (chunks, why) in [
            (vec![], "no voxel"),
            (vec![size.clone()], "no voxel"),
            (vec![voxels.clone()], "a model has no size"),
            (vec![size.clone(), chunk(b"XYZI", &numbers(&[9, 0]))], "fewer voxels"),
            (vec![size.clone(), chunk(b"XYZI", &[])], "fewer voxels"),
            (node(&[("_r", "5")]).to_vec(), "node 0 of the scene: its rotation is none"),
            (node(&[("_r", "300")]).to_vec(), "its rotation is none"),
            (node(&[("_t", "1 2")]).to_vec(), "its translation is not three"),
            (node(&[("_t", "1 2 99999999999")]).to_vec(), "its translation is not three"),
            (node(&[("_t", "1 2 40000")]).to_vec(), "[1, 2, 40000] is out of range"),
            (
                vec![size.clone(), voxels.clone(), transform(0, 1, 0, &[], &[]), shape(1, 8)],
                "its model is not",
            ),
            (
                vec![size.clone(), voxels.clone(), transform(1, 0, 0, &[], &[])],
                "byte 64: the nodes of the scene",
            ),
            (vec![size.clone(), voxels.clone(), layer(3, true)], "the layers of the scene"),
            (vec![size.clone(), voxels.clone(), chunk(b"nGRP", &numbers(&[0, 0, 9]))], "ends early"),
        ] {
            let error = read(&chunks).unwrap_err();
            assert!(error.contains(why), "{why}: {error}");
        }
        // Nested chunks, which a reader that follows them by recursion would not survive.
        let nested = (0..=100_000).rev().map(|left| numbers(&[0, CHUNK as u32 * left]));
        let nested = nested.flat_map(|lengths| [&b"MAIN"[..], &lengths].concat());
        let deep = [&b"VOX "[..], &numbers(&[150]), &nested.collect::<Vec<u8>>()].concat();
        let error = cells("a.vox", &deep).unwrap_err().to_string();
        assert!(error.contains("byte 20: chunks within a chunk"), "{error}");
        let many = file(&vec![chunk(b"NOTE", &[]); MAX_VOX_CHUNKS + 1]);
        assert!(cells("a.vox", &many).unwrap_err().to_string().contains("chunks"));
        let long = file(&[chunk(b"MATL", &vec![0; MAX_VOX_SCENE + 1])]);
        assert!(cells("a.vox", &long).unwrap_err().to_string().contains("bytes that describe"));
    }

    /// Every byte of a file changed to every other: an answer or an error, and no panic.
    #[test]
    fn no_changed_byte_makes_the_reader_panic() {
        let [size, voxels] = model([2, 3, 1], &CORNER);
        let good = file(&[
            size,
            voxels,
            transform(0, 1, 0, &[("_name", "a")], &[("_r", "17"), ("_t", "1 2 3")]),
            group(1, &[2]),
            transform(2, 3, 0, &[], &[]),
            shape(3, 0),
            layer(0, false),
        ]);
        let (mut read, mut refused) = (0, 0);
        for at in 0..good.len() {
            for value in [0, 1, 2, 15, 17, 31, 48, 57, 64, 127, 128, 200, 254, 255] {
                let mut changed = good.clone();
                changed[at] = value;
                match cells("a.vox", &changed) {
                    Ok(_) => read += 1,
                    Err(_) => refused += 1,
                }
            }
        }
        assert!(read > 100 && refused > 100, "{read} {refused}");
    }
}
