//! A structure as URDF, the format of ROS: one robot, a tree of links from the link `base`.

use super::structure::{Geometry, Joint, Link, Look, Motion, Solid, Structure};
use super::xml::{numbers, pose_numbers};
use metamorph_scene::figure::picture::escaped;
use nalgebra::Isometry3;
use std::fmt::Write;

/// Returns the file. `name` is the robot's, `comment` says what it is made from.
pub fn urdf(structure: &Structure, name: &str, comment: &str) -> String {
    let mut text = String::new();
    // Invariant: writing to a `String` does not fail.
    let _ = write_robot(&mut text, structure, name, comment);
    text
}

fn write_robot(out: &mut String, structure: &Structure, name: &str, comment: &str) -> std::fmt::Result {
    writeln!(out, "<?xml version=\"1.0\"?>\n<!-- {} -->", comment.replace("--", "- -"))?;
    if !structure.loops.is_empty() {
        let loops = structure.loops.len();
        writeln!(out, "<!-- {loops} further connections would close loops, which URDF does not have. -->")?;
    }
    writeln!(out, "<robot name=\"{}\">", escaped(name))?;
    for look in Look::ALL {
        let (name, colour) = (look.name(), look.colour());
        writeln!(out, "  <material name=\"{name}\"><color rgba=\"{colour}\"/></material>")?;
    }
    writeln!(out, "  <link name=\"base\"/>")?;
    for link in structure.links.iter().chain(&structure.obstacles) {
        write_link(out, link)?;
    }
    for joint in &structure.tree {
        write_joint(out, &structure.links, joint)?;
    }
    for obstacle in &structure.obstacles {
        let name = &obstacle.name;
        writeln!(
            out,
            "  <joint name=\"base_to_{name}\" type=\"fixed\"><parent link=\"base\"/><child link=\"{name}\"/>{}</joint>",
            origin(&obstacle.pose)
        )?;
    }
    writeln!(out, "</robot>")
}

/// Returns the element of a pose: angles are roll, pitch and yaw.
fn origin(pose: &Isometry3<f64>) -> String {
    let [x, y, z, r, p, w] = pose_numbers(pose);
    format!("<origin xyz=\"{}\" rpy=\"{}\"/>", numbers(&[x, y, z]), numbers(&[r, p, w]))
}

fn write_link(out: &mut String, link: &Link) -> std::fmt::Result {
    let inertial = link.inertial();
    let m = inertial.inertia;
    writeln!(out, "  <link name=\"{}\">", link.name)?;
    let centre = Isometry3::translation(inertial.centre.x, inertial.centre.y, inertial.centre.z);
    writeln!(
        out,
        "    <inertial>{}<mass value=\"{}\"/><inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/></inertial>",
        origin(&centre),
        numbers(&[inertial.mass]),
        numbers(&[m[(0, 0)]]),
        numbers(&[m[(0, 1)]]),
        numbers(&[m[(0, 2)]]),
        numbers(&[m[(1, 1)]]),
        numbers(&[m[(1, 2)]]),
        numbers(&[m[(2, 2)]]),
    )?;
    for Solid { pose, geometry, look, .. } in &link.solids {
        let form = match geometry {
            Geometry::Box(size) => format!("<box size=\"{}\"/>", numbers(size)),
            Geometry::Sphere(radius) => format!("<sphere radius=\"{}\"/>", numbers(&[*radius])),
        };
        let form = format!("{}<geometry>{form}</geometry>", origin(pose));
        writeln!(out, "    <visual>{form}<material name=\"{}\"/></visual>", look.name())?;
        writeln!(out, "    <collision>{form}</collision>")?;
    }
    writeln!(out, "  </link>")
}

fn write_joint(out: &mut String, links: &[Link], joint: &Joint) -> std::fmt::Result {
    let child = &links[joint.child];
    let (parent, pose) = match joint.parent {
        Some(parent) => (links[parent].name.as_str(), links[parent].pose.inverse() * child.pose),
        None => ("base", child.pose),
    };
    let (kind, axis) = match joint.motion {
        Motion::Fixed => ("fixed", String::new()),
        Motion::Turns(axis) => {
            ("continuous", format!("<axis xyz=\"{}\"/>", numbers(&[axis.x, axis.y, axis.z])))
        }
    };
    writeln!(
        out,
        "  <joint name=\"{parent}_to_{0}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{0}\"/>{1}{axis}</joint>",
        child.name,
        origin(&pose),
    )
}
