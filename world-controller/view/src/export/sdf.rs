//! A structure as SDF 1.9, the format of Gazebo: a world with one model, and a static model for each foreign object.

use super::structure::{Geometry, Inertial, Joint, Link, Motion, Solid, Structure};
use super::xml::{numbers, pose_numbers};
use metamorph_scene::figure::picture::escaped;
use nalgebra::Isometry3;
use std::fmt::Write;

/// Returns the file. `name` is the model's, `comment` says what it is made from. `grounded` is true if the base is
/// the world.
pub fn sdf(structure: &Structure, name: &str, comment: &str, grounded: bool) -> String {
    let mut text = String::new();
    // Invariant: writing to a `String` does not fail.
    let _ = write_world(&mut text, structure, name, comment, grounded);
    text
}

fn write_world(
    out: &mut String,
    structure: &Structure,
    name: &str,
    comment: &str,
    grounded: bool,
) -> std::fmt::Result {
    writeln!(out, "<?xml version=\"1.0\"?>\n<!-- {} -->", comment.replace("--", "- -"))?;
    writeln!(out, "<sdf version=\"1.9\">\n<world name=\"metamorph\">\n<model name=\"{}\">", escaped(name))?;
    for link in &structure.links {
        write_link(out, link)?;
    }
    for joint in structure.tree.iter().chain(&structure.loops) {
        write_joint(out, &structure.links, joint, grounded)?;
    }
    writeln!(out, "</model>")?;
    for obstacle in &structure.obstacles {
        writeln!(out, "<model name=\"{}\"><static>true</static>", obstacle.name)?;
        write_link(out, obstacle)?;
        writeln!(out, "</model>")?;
    }
    writeln!(out, "</world>\n</sdf>")
}

fn pose(pose: &Isometry3<f64>) -> String {
    format!("<pose>{}</pose>", numbers(&pose_numbers(pose)))
}

fn write_link(out: &mut String, link: &Link) -> std::fmt::Result {
    let Inertial { mass, centre, inertia: m } = link.inertial();
    writeln!(out, "<link name=\"{}\">{}", link.name, pose(&link.pose))?;
    let centre = Isometry3::translation(centre.x, centre.y, centre.z);
    let terms = [("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)];
    let terms = terms.map(|(name, row, column)| format!("<{name}>{}</{name}>", numbers(&[m[(row, column)]])));
    let mass = numbers(&[mass]);
    writeln!(
        out,
        "<inertial>{}<mass>{mass}</mass><inertia>{}</inertia></inertial>",
        pose(&centre),
        terms.concat()
    )?;
    for Solid { name, pose: at, geometry, look, .. } in &link.solids {
        let form = match geometry {
            Geometry::Box(size) => format!("<box><size>{}</size></box>", numbers(size)),
            Geometry::Sphere(radius) => format!("<sphere><radius>{}</radius></sphere>", numbers(&[*radius])),
        };
        let form = format!("{}<geometry>{form}</geometry>", pose(at));
        let colour = look.colour();
        writeln!(out, "<collision name=\"{name}_collision\">{form}</collision>")?;
        writeln!(
            out,
            "<visual name=\"{name}_visual\">{form}<material><ambient>{colour}</ambient><diffuse>{colour}</diffuse></material></visual>"
        )?;
    }
    writeln!(out, "</link>")
}

fn write_joint(out: &mut String, links: &[Link], joint: &Joint, grounded: bool) -> std::fmt::Result {
    let child = &links[joint.child].name;
    let parent = match joint.parent {
        Some(parent) => links[parent].name.as_str(),
        None if grounded => "world",
        // A structure that stands on nothing falls.
        None => return Ok(()),
    };
    let (kind, axis) = match joint.motion {
        Motion::Fixed => ("fixed", String::new()),
        Motion::Turns(axis) => {
            ("revolute", format!("<axis><xyz>{}</xyz></axis>", numbers(&[axis.x, axis.y, axis.z])))
        }
    };
    writeln!(
        out,
        "<joint name=\"{parent}_to_{child}\" type=\"{kind}\"><parent>{parent}</parent><child>{child}</child>{axis}</joint>"
    )
}
