//! Puts the house together: arcade, vaults, walls, roofs, floors and lawns, as shared meshes on nodes.

use std::f64::consts::PI;

use glam::DVec3;
use serde_json::json;

use super::glb::{Glb, Id, at, mesh_node, scaled, turned};
use super::layout::{
    ARCADE, ARCADE_HALF, ARCH_HALF, BAY, BAYS, HALF_RUN, OUTSIDE, SPRINGING, WALK_IN, WALK_OUT, WALL_TOP, bay_x,
    column_x,
};
use super::materials::Palette;
use super::rng::Rng;
use super::{arcade, paving, roof, vault, walls};

/// Edges flatter than this are smooth.
pub(crate) const CREASE_DEG: f64 = 38.0;

/// A node for each side, turned into place: south, east, north, west. Inside, x runs along the side and z points
/// outwards.
pub(crate) fn sides(glb: &mut Glb) -> [Id; 4] {
    // Quarter turns as matrices, whose entries are exact, so that bays meet without a gap.
    let turns = [("south", 0.0, 1.0), ("east", 1.0, 0.0), ("north", 0.0, -1.0), ("west", -1.0, 0.0)];
    turns.map(|(name, s, c)| {
        let mut node = json!({ "name": name });
        if c < 1.0 {
            node["matrix"] = json!([c, 0.0, -s, 0.0, 0.0, 1.0, 0.0, 0.0, s, 0.0, c, 0.0, 0.0, 0.0, 0.0, 1.0]);
        }
        glb.node(None, node)
    })
}

pub(crate) fn add(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    add_arcade(glb, palette, sides);
    add_vaults(glb, palette, sides);
    add_walls(glb, palette, sides);
    add_roofs(glb, palette, sides);
    add_ground(glb, palette, sides);
}

fn add_arcade(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let column = glb.mesh("column", &[(palette.stone, arcade::column().weld(CREASE_DEG))]);
    let impost = glb.mesh("impost", &[(palette.stone, arcade::impost().weld(20.0))]);
    let bay = glb.mesh(
        "arcade bay",
        &[
            (palette.ashlar, arcade::bay_wall().weld(CREASE_DEG)),
            (palette.stone, arcade::archivolt(ARCH_HALF, SPRINGING, ARCADE_HALF).weld(CREASE_DEG)),
            (palette.stone, arcade::tracery().weld(30.0)),
        ],
    );
    let low_wall = glb.mesh("low wall", &[(palette.ashlar, arcade::low_wall().weld(20.0))]);
    let pier = glb.mesh("corner pier", &[(palette.ashlar, arcade::pier().weld(20.0))]);
    for side in sides {
        let arcade = glb.node(Some(side), at(json!({ "name": "arcade" }), DVec3::Z * ARCADE));
        for index in 0..=BAYS {
            let x = DVec3::X * column_x(index);
            for z in [-0.165, 0.165] {
                glb.node(Some(arcade), at(mesh_node("column", column), x + DVec3::Z * z));
            }
            glb.node(Some(arcade), at(mesh_node("impost", impost), x));
        }
        for index in 0..BAYS {
            glb.node(Some(arcade), at(mesh_node("bay", bay), DVec3::X * bay_x(index)));
        }
        glb.node(Some(arcade), mesh_node("low wall", low_wall));
        // The other half is its mirror image.
        glb.node(Some(arcade), scaled(mesh_node("low wall", low_wall), DVec3::new(-1.0, 1.0, 1.0)));
        glb.node(Some(arcade), at(mesh_node("pier", pier), DVec3::X * ARCADE));
    }
    let cornice = glb.mesh("cornice", &[(palette.stone, arcade::cornice().weld(20.0))]);
    glb.node(None, mesh_node("cornice", cornice));
}

fn add_vaults(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let cell = glb.mesh("vault cell", &[(palette.vault, vault::cell().weld(CREASE_DEG))]);
    let ribs = glb.mesh("vault ribs", &[(palette.stone, vault::ribs().weld(CREASE_DEG))]);
    let transverse = glb.mesh("transverse arch", &[(palette.stone, vault::transverse_arch().weld(30.0))]);
    let corbel = glb.mesh("corbel", &[(palette.stone, arcade::corbel(SPRINGING - 0.11).weld(CREASE_DEG))]);
    let corner_scale = DVec3::new((WALK_OUT - WALK_IN) / BAY, 1.0, 1.0);
    // At the corners a wide arch fills what the bays leave.
    let wide = WALK_IN - HALF_RUN;
    for side in sides {
        for index in 0..BAYS {
            for (name, mesh) in [("vault", cell), ("ribs", ribs)] {
                glb.node(Some(side), at(mesh_node(name, mesh), vault::in_walk(bay_x(index))));
            }
        }
        for (name, mesh) in [("corner vault", cell), ("corner ribs", ribs)] {
            let node = at(mesh_node(name, mesh), vault::in_walk(WALK_IN + vault::WALK_HALF));
            glb.node(Some(side), scaled(node, corner_scale));
        }
        for index in 0..=BAYS {
            let (x, width) = match index {
                0 => (-HALF_RUN - wide * 0.5, wide + 0.06),
                BAYS => (HALF_RUN + wide * 0.5, wide + 0.06),
                _ => (column_x(index), vault::TRANSVERSE_WIDTH),
            };
            let node = at(mesh_node("transverse arch", transverse), vault::in_walk(x));
            glb.node(Some(side), scaled(node, DVec3::new(width / vault::TRANSVERSE_WIDTH, 1.0, 1.0)));
            if (1..BAYS).contains(&index) {
                glb.node(Some(side), at(mesh_node("corbel", corbel), DVec3::new(column_x(index), 0.0, WALK_OUT)));
            }
        }
    }
}

fn add_walls(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let wall = glb.mesh("outer wall", &[(palette.plaster, walls::wall().weld(20.0))]);
    for side in sides {
        glb.node(Some(side), mesh_node("outer wall", wall));
    }
    let trim = glb.mesh(
        "wall trim",
        &[
            (palette.ashlar, walls::dado().weld(25.0)),
            (palette.stone, walls::string_course().weld(25.0)),
            (palette.stone, walls::coping().weld(20.0)),
        ],
    );
    glb.node(None, mesh_node("wall trim", trim));
    let door = glb.mesh(
        "door",
        &[
            (palette.stone, walls::door_frame().weld(CREASE_DEG)),
            (palette.wood, walls::door_leaf().weld(20.0)),
            (palette.iron, walls::door_iron().weld(CREASE_DEG)),
        ],
    );
    for (side, bay) in [(2, 3), (3, 3), (1, 5)] {
        glb.node(Some(sides[side]), at(mesh_node("door", door), DVec3::new(bay_x(bay), 0.0, WALK_OUT)));
    }
    let gable = glb.mesh("bell gable", &[(palette.ashlar, walls::gable().weld(20.0))]);
    let bell =
        glb.mesh("bell", &[(palette.bronze, walls::bell().weld(CREASE_DEG)), (palette.wood, walls::yoke().weld(20.0))]);
    let top = glb.node(
        Some(sides[2]),
        at(json!({ "name": "bell gable" }), DVec3::new(0.0, WALL_TOP, (WALK_OUT + OUTSIDE) * 0.5)),
    );
    glb.node(Some(top), mesh_node("gable", gable));
    for x in [-0.625, 0.625] {
        let size = if x < 0.0 { 1.0 } else { 0.86 };
        glb.node(Some(top), scaled(at(mesh_node("bell", bell), DVec3::new(x, 1.95, 0.0)), DVec3::splat(size)));
    }
    let vane = glb.mesh("vane", &[(palette.iron, walls::vane().weld(CREASE_DEG))]);
    glb.node(Some(top), turned(at(mesh_node("vane", vane), DVec3::Y * 3.75), PI * 0.2));
}

fn add_roofs(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let roof = glb.mesh(
        "roof",
        &[
            (palette.tile_bed, roof::slab().weld(20.0)),
            (palette.wood, roof::rafters().weld(20.0)),
            (palette.tile, roof::tiles(&mut Rng::new(0x7113)).weld(50.0)),
            (palette.lead, roof::valley().weld(20.0)),
        ],
    );
    for side in sides {
        glb.node(Some(side), mesh_node("roof", roof));
    }
}

fn add_ground(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let walk = glb.mesh(
        "walk",
        &[
            (palette.flagstone, paving::walk(&mut Rng::new(0xf1a6)).weld(50.0)),
            (palette.joint, paving::bed().weld(20.0)),
            (palette.flagstone, paving::paths(&mut Rng::new(0xf1a7)).weld(50.0)),
        ],
    );
    let quarter =
        glb.mesh("lawn", &[(palette.grass, paving::lawn().weld(60.0)), (palette.stone, paving::kerbs().weld(20.0))]);
    for side in sides {
        glb.node(Some(side), mesh_node("walk", walk));
        glb.node(Some(side), mesh_node("lawn", quarter));
    }
    let middle = glb.mesh(
        "garth",
        &[
            (palette.joint, paving::soil().weld(20.0)),
            (palette.flagstone, paving::plaza(&mut Rng::new(0xf1a8)).weld(50.0)),
        ],
    );
    glb.node(None, mesh_node("garth", middle));
}
