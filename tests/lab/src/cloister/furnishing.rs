//! Furnishes the cloister: fountain, sundial, well, tree, pots, benches and hangings.

use std::f64::consts::PI;

use super::glb::{Glb, Id, at, mesh_node, scaled, turned};
use super::house::CREASE_DEG;
use super::layout::{ARCADE, CAPITAL, GARTH, bay_x};
use super::materials::Palette;
use super::paving::lawn_y;
use super::rng::Rng;
use super::{fountain, hangings, plants, sundial, tree, well};
use glam::DVec3;

pub(crate) const WELL: DVec3 = DVec3::new(3.9, 0.0, 3.9);
pub(crate) const SUNDIAL: DVec3 = DVec3::new(3.9, 0.0, -3.7);
pub(crate) const TREE: DVec3 = DVec3::new(-4.5, 0.0, -4.2);
pub(crate) const URN: DVec3 = DVec3::new(-3.9, GARTH, 3.9);
pub(crate) const ARMILLARY: DVec3 = DVec3::new(0.0, fountain::STEM_TOP, 0.0);

/// Adds all furnishings except moving parts and lights.
pub(crate) fn add(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    add_middle(glb, palette);
    add_tree(glb, palette);
    add_plants(glb, palette, sides);
    add_cloth(glb, palette, sides);
}

fn add_middle(glb: &mut Glb, palette: &Palette) {
    let mesh = glb.mesh(
        "fountain",
        &[
            (palette.stone, fountain::basin().weld(25.0)),
            (palette.stone, fountain::stem().weld(CREASE_DEG)),
            (palette.water, fountain::water().weld(CREASE_DEG)),
        ],
    );
    glb.node(None, mesh_node("fountain", mesh));
    let mesh = glb.mesh(
        "sundial",
        &[
            (palette.stone, sundial::pedestal().weld(CREASE_DEG)),
            (palette.bronze, sundial::dial().weld(CREASE_DEG)),
            (palette.iron, sundial::lines().weld(CREASE_DEG)),
        ],
    );
    glb.node(None, at(mesh_node("sundial", mesh), SUNDIAL));
    let mesh = glb.mesh(
        "well",
        &[
            (palette.stone, well::stone().weld(CREASE_DEG)),
            (palette.iron, well::iron().weld(CREASE_DEG)),
            (palette.iron, well::lattice().weld(CREASE_DEG)),
        ],
    );
    glb.node(None, at(mesh_node("well", mesh), WELL));
}

fn add_tree(glb: &mut Glb, palette: &Palette) {
    let tree = tree::grow(&mut Rng::new(0x011_4e5));
    let mesh = glb.mesh("tree", &[(palette.bark, tree.wood.weld(60.0)), (palette.olive, tree.leaves.weld(60.0))]);
    glb.node(None, at(mesh_node("tree", mesh), TREE + DVec3::Y * lawn_y(TREE.x, TREE.z)));
}

fn add_plants(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let pot = plants::pot().weld(30.0);
    let soil = plants::pot_soil().weld(30.0);
    let shrub = plants::shrub(&mut Rng::new(0x5b), 0.9).weld(60.0);
    let fern = plants::fern(&mut Rng::new(0xfe), 0.9).weld(60.0);
    let flowers = plants::flowers(&mut Rng::new(0xf1), 0.9, 0.38, 12).weld(60.0);
    let potted = [("potted shrub", shrub), ("potted fern", fern), ("potted flowers", flowers)].map(|(name, plant)| {
        glb.mesh(name, &[(palette.glaze, pot.clone()), (palette.soil, soil.clone()), (palette.leaf, plant)])
    });
    // (kind, x, z, height, turn, mirrored): pairs beside the paths, groups in the corners of the garth.
    let places = [
        (0, 1.9, 7.02, 0.62, 0.3, false),
        (0, -1.9, 7.02, 0.62, 0.3, true),
        (1, 7.02, 1.9, 0.62, 1.1, false),
        (1, 7.02, -1.9, 0.62, 1.1, true),
        (0, 1.9, -7.02, 0.62, 2.0, true),
        (0, -1.9, -7.02, 0.62, 2.0, false),
        (1, -7.02, 1.9, 0.62, 0.0, true),
        (1, -7.02, -1.9, 0.62, 4.0, false),
        (2, 6.9, -6.9, 0.50, 0.9, false),
        (1, 6.15, -6.95, 0.72, 2.9, false),
        (0, 6.95, -6.1, 0.66, 5.1, true),
        (2, -6.9, -6.9, 0.55, 3.3, true),
        (0, -6.1, -6.95, 0.70, 1.3, false),
        (1, 6.9, 6.9, 0.70, 2.2, true),
        (2, 6.2, 6.95, 0.5, 0.2, false),
        (0, -6.9, 6.9, 0.72, 0.0, false),
        (2, -6.95, 6.15, 0.5, 4.4, true),
    ];
    for (kind, x, z, height, turn, mirrored) in places {
        let node = turned(at(mesh_node("pot", potted[kind]), DVec3::new(x, GARTH - 0.005, z)), turn);
        let mirror = if mirrored { -1.0 } else { 1.0 };
        glb.node(None, scaled(node, DVec3::new(mirror, 1.0, 1.0) * height));
    }
    let mut bed = plants::flowers(&mut Rng::new(0xbed), 0.5, 0.16, 7).moved(DVec3::X * -0.45);
    bed.append(plants::flowers(&mut Rng::new(0xbee), 0.5, 0.16, 7));
    bed.append(plants::flowers(&mut Rng::new(0xbef), 0.5, 0.16, 7).moved(DVec3::X * 0.45));
    let trough = glb.mesh(
        "trough",
        &[
            (palette.stone, plants::trough().weld(20.0)),
            (palette.soil, plants::trough_soil().weld(20.0)),
            (palette.leaf, bed.weld(60.0)),
        ],
    );
    for (side, bay) in [(1, 1), (2, 5), (2, 1), (3, 5), (0, 5)] {
        let place = DVec3::new(bay_x(bay), GARTH, ARCADE - 0.68);
        glb.node(Some(sides[side]), at(mesh_node("trough", trough), place));
    }
    let tuft = glb.mesh("tuft", &[(palette.leaf, plants::flowers(&mut Rng::new(0x7f), 0.0, 0.45, 11).weld(60.0))]);
    let mut rng = Rng::new(0x6ea);
    for k in 0..26u8 {
        let quarter = k % 4;
        let (x, z) = (rng.between(1.7, 6.0), rng.between(1.7, 6.0));
        let (x, z) = (if quarter & 1 == 0 { x } else { -x }, if quarter & 2 == 0 { z } else { -z });
        let place = DVec3::new(x, lawn_y(x.abs(), z.abs()), z);
        let clear = [WELL, SUNDIAL, URN].iter().all(|p| p.distance(DVec3::new(x, 0.0, z)) > 2.0) && x.hypot(z) > 4.1;
        let (turn, size) = (rng.between(0.0, 6.0), rng.between(0.5, 0.8));
        if clear {
            glb.node(None, scaled(turned(at(mesh_node("tuft", tuft), place), turn), DVec3::splat(size)));
        }
    }
    let urn = glb.mesh(
        "urn",
        &[
            (palette.stone, plants::urn().weld(CREASE_DEG)),
            (palette.soil, plants::pot_soil().placed(plants::in_urn()).weld(30.0)),
            (palette.leaf, plants::fern(&mut Rng::new(0xfe2), 1.72).weld(60.0)),
        ],
    );
    glb.node(None, at(mesh_node("urn", urn), URN));
    for k in 0..8u8 {
        let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
        let (x, z) = (URN.x + 1.05 * s, URN.z + 1.05 * c);
        let node = turned(at(mesh_node("tuft", tuft), DVec3::new(x, lawn_y(x, z), z)), f64::from(k));
        glb.node(None, scaled(node, DVec3::splat(0.8)));
    }
    let bench = glb.mesh("bench", &[(palette.stone, hangings::bench().weld(20.0))]);
    for (side, x) in [(0, bay_x(1)), (2, bay_x(1)), (2, bay_x(5)), (1, bay_x(2)), (3, bay_x(1))] {
        glb.node(Some(sides[side]), at(mesh_node("bench", bench), DVec3::new(x, 0.0, 10.82)));
    }
}

fn add_cloth(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let rod = hangings::rod().weld(CREASE_DEG);
    let sheet = hangings::banner().weld(80.0);
    let banners = [("teal banner", palette.teal), ("ochre banner", palette.ochre)]
        .map(|(name, cloth)| glb.mesh(name, &[(cloth, sheet.clone()), (palette.iron, rod.clone())]));
    // Banners hang in arches of the sunny sides, from rods between the imposts; most arches stay open to the sun.
    for (side, bay, kind) in [(2, 1, 1), (2, 5, 0), (1, 0, 0), (1, 2, 1), (1, 6, 0), (3, 2, 0)] {
        let mirror = if bay > 3 { -1.0 } else { 1.0 };
        let node = at(mesh_node("banner", banners[kind]), DVec3::new(bay_x(bay), CAPITAL + 0.08, ARCADE));
        glb.node(Some(sides[side]), scaled(node, DVec3::new(mirror, 1.0, 1.0)));
    }
    let swag = glb.mesh("swag", &[(palette.ochre, hangings::swag(1.85).weld(80.0))]);
    for bay in [1usize, 5] {
        let node = at(mesh_node("swag", swag), DVec3::new(bay_x(bay), 2.38, ARCADE + 0.02));
        glb.node(Some(sides[3]), turned(node, PI));
    }
}
