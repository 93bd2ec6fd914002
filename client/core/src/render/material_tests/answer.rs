//! How surfaces answer light.

use std::f64::consts::PI;

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_protocol::mask::MaskShape;
use gnomon_scene::{AlphaMode, Clearcoat, Draw, Material, Sheen, Specular, Transmission};

use super::*;

#[test]
fn metal_and_paint_answer_light_as_appendix_b_says() {
    let plain = || Material { base_color: paint([230, 160, 80]), ..Material::default() };
    let specular = Specular { strength: 0.6, color: Vec3::new(1.0, 0.5, 0.2), ..Specular::default() };
    let materials = [
        ("chalk", plain()),
        ("plastic", Material { roughness: 0.4, ..plain() }),
        ("metal", Material { metallic: 1.0, roughness: 0.4, ..plain() }),
        ("rough metal", Material { metallic: 1.0, roughness: 1.0, ..plain() }),
        ("half metal", Material { metallic: 0.6, roughness: 0.6, ..plain() }),
        ("diamond", Material { ior: 2.4, roughness: 0.4, ..plain() }),
        ("tinted", Material { ior: 1.8, specular, roughness: 0.4, ..plain() }),
    ];
    for (name, material) in materials {
        let expected = Expected::of(&material);
        let scene = card(material);
        let light = light_of(&scene);
        let mut brightest = 0.0_f64;
        for (place, _, eye) in seen() {
            let answer = expected.answer(DVec3::Z, toward(&scene), eye) * irradiance(&scene);
            assert_near(light[place], answer, name);
            brightest = brightest.max(answer.max_element());
        }
        assert!(brightest > 0.5, "{name}: {brightest}");
    }
}

#[test]
fn normals_that_face_away_from_the_eye_have_no_highlight() {
    let material = Material { roughness: 0.9, ..Material::default() };
    let expected = Expected::of(&material);
    let mut scene = card(material);
    // Half way between a light that is nearly behind and the eye lies what is opposite to the normal.
    let eye = camera().position_m.normalize();
    let normal = (eye.cross(DVec3::Y).normalize() * 0.95 - eye * 0.3).normalize();
    scene.normals = vec![normal.as_vec3(); 4];
    scene.lights[0].direction = (eye + normal * 0.27).normalize().as_vec3();
    let light = light_of(&scene);
    let mut opposite = 0;
    for (place, _, eye) in seen() {
        let answer = expected.answer(normal, toward(&scene), eye) * irradiance(&scene);
        assert_near(light[place], answer, "averted");
        let lit = answer.max_element() > 0.0;
        opposite += u32::from(lit && normal.dot((toward(&scene) + eye).normalize()) < -0.5);
    }
    assert!(opposite > 20, "{opposite}");
}

#[test]
fn the_visibility_bit_hides_highlights_too() {
    let material = Material { metallic: 1.0, roughness: 0.4, ..Material::default() };
    let scene = card(material);
    let dark = Mask::new(MaskShape::new(SIDE, SIDE, 1).unwrap());
    let light = light_with(&scene, &camera(), Some(&dark));
    for (place, ..) in seen() {
        assert_eq!(light[place], DVec3::ZERO);
    }
}

#[test]
fn lacquer_and_sheen_lie_over_the_base() {
    let base = Material { base_color: paint([120, 60, 60]), roughness: 0.9, ..Material::default() };
    let clearcoat = Clearcoat { strength: 0.8, roughness: 0.3, ..Clearcoat::default() };
    let scene = card(Material { clearcoat, ..base.clone() });
    let light = light_of(&scene);
    let below = Expected::of(&base);
    let toward = toward(&scene);
    for (place, _, eye) in seen() {
        let half_way = (toward + eye).normalize();
        let coat = fresnel(DVec3::splat(0.04), 1.0, eye.z) * 0.8;
        let shine = PI * lobe(0.3_f64.powi(2), half_way.z, toward.z, eye.z) * toward.z * 0.8;
        let answer = below.answer(DVec3::Z, toward, eye) * (DVec3::ONE - coat)
            + fresnel(DVec3::splat(0.04), 1.0, eye.dot(half_way)) * shine;
        assert_near(light[place], answer * irradiance(&scene), "lacquer");
    }
    // Of black cloth only the sheen is seen (KHR_materials_sheen: Charlie's D, Neubelt's V).
    let sheen = Sheen { color: Vec3::new(0.5, 0.4, 0.1), roughness: 0.5, ..Sheen::default() };
    let specular = Specular { strength: 0.0, ..Specular::default() };
    let black = Material { base_color: Vec4::new(0.0, 0.0, 0.0, 1.0), specular, sheen, ..Material::default() };
    let scene = card(black);
    let light = light_of(&scene);
    for (place, _, eye) in seen() {
        let half_way = (toward + eye).normalize();
        let inverse = 1.0 / 0.25;
        let spread = (2.0 + inverse) * (1.0 - half_way.z.powi(2)).max(0.0078125).powf(0.5 * inverse) / (2.0 * PI);
        let shadowed = (1.0 / (4.0 * (toward.z + eye.z - toward.z * eye.z))).min(1.0);
        let answer = DVec3::new(0.5, 0.4, 0.1) * (PI * spread * shadowed * toward.z);
        assert_near(light[place], answer * irradiance(&scene), "sheen");
    }
}

#[test]
fn what_lies_behind_coloured_glass_is_seen_in_its_colour() {
    let mut scene = card(Material { base_color: Vec4::new(0.5, 0.5, 0.5, 1.0), unlit: true, ..Material::default() });
    scene.lights[0].intensity = 0.0;
    let without = light_of(&scene);
    // A pane over the right half, 5 cm nearer.
    let corners = [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)];
    scene.positions.extend(corners.map(|(x, y)| Vec3::new(x, y, 0.05)));
    scene.normals.extend([Vec3::Z; 4]);
    scene.uvs.extend([Vec2::ZERO; 4]);
    scene.triangles.extend([[4, 5, 6], [4, 6, 7]]);
    scene.draws.push(Draw { first_triangle: 2, triangles: 2, material: 1 });
    scene.materials.push(Material {
        base_color: Vec4::new(0.9, 0.5, 0.1, 1.0),
        alpha: AlphaMode::Blend,
        transmission: Transmission { factor: 0.8, texture: None },
        specular: Specular { strength: 0.0, ..Specular::default() },
        ..Material::default()
    });
    let with = light_of(&scene);
    let passed = DVec3::new(0.9, 0.5, 0.1) * 0.8;
    let mut through = 0;
    for (place, point, _) in seen() {
        if point.x < -0.1 {
            assert_eq!(with[place], without[place]);
        } else if point.x > 0.1 && point.x < 0.9 && point.y.abs() < 0.9 {
            assert_near(with[place], without[place] * passed, "pane");
            through += 1;
        }
    }
    assert!(through > 100);
}

#[test]
fn light_ends_smoothly_where_facets_of_a_smooth_mesh_may_have_turned_away() {
    // A flat card with the normals of a ball, lit at 80° from its own normal.
    let specular = Specular { strength: 0.0, ..Specular::default() };
    let mut scene = card(Material { specular, ..Material::default() });
    let bent = |x: f32| Vec3::new(0.2 * x, 0.0, 1.0).normalize();
    scene.normals = [-1.0, 1.0, 1.0, -1.0].map(bent).to_vec();
    let toward = Vec3::new(80_f32.to_radians().sin(), 0.0, 80_f32.to_radians().cos());
    scene.lights[0].direction = -toward;
    // The sine of the angle between the corners' normals and the card's.
    let edge = bent(1.0).as_dvec3();
    let facing = |point: DVec3| DVec3::new(edge.x * point.x, 0.0, edge.z).normalize().dot(toward.as_dvec3());
    let mut lit = Mask::new(MaskShape::new(SIDE, SIDE, 1).unwrap());
    lit.words_mut().fill(u64::MAX);
    let (softened, plain) = (light_with(&scene, &camera(), Some(&lit)), light_of(&scene));
    let (mut dark, mut between) = (0, 0);
    for (place, point, _) in seen() {
        let facing = facing(point);
        // Without visibility nothing is softened.
        assert_near(plain[place], irradiance(&scene) * facing.max(0.0), "plain");
        let share = (facing / edge.x - 1.0).clamp(0.0, 1.0);
        let expected = irradiance(&scene) * facing * share * share * (3.0 - 2.0 * share);
        // The lean has 8 bits, so the share is off by a fiftieth, and what is shown by three times that at most.
        let error = (softened[place] - expected).abs().max_element();
        assert!(error < 0.06 * irradiance(&scene).x * facing.max(0.0) + 1e-3, "{} {expected}", softened[place]);
        dark += u32::from(share == 0.0);
        between += u32::from(share > 0.1 && share < 0.9);
    }
    assert!(dark > 100 && between > 100, "{dark} {between}");
}
