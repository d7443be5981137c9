//! Which objects are measured, and in which images.

use serde::Serialize;

use interfacet::phantom::SceneName;

/// What spoils the image.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Condition {
    /// As printed.
    pub title: &'static str,
    /// Percent of the smallest difference of two materials.
    pub noise: f64,
    /// How much darker materials are in the middle, as a share.
    pub cupping: f64,
}

/// The columns of the table.
pub(crate) const CONDITIONS: [Condition; 3] = [
    Condition { title: "noise 1 %", noise: 1.0, cupping: 0.0 },
    Condition { title: "noise 4 %", noise: 4.0, cupping: 0.0 },
    Condition { title: "cupping 10 %, noise 2 %", noise: 2.0, cupping: 0.1 },
];

/// Which table an object is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Role {
    /// The table of targets.
    General,
    /// Thin plates, gaps and layers.
    Thin,
    /// Small pores and inclusions.
    Small,
    /// Rounded edges.
    Fillet,
}

/// An object.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct Case {
    /// Its scene.
    pub scene: SceneName,
    /// What it is for.
    pub role: Role,
    /// The number that goes with the scene (thickness, angle or radius), 0 if none does.
    pub number: f64,
}

impl Case {
    /// As printed.
    pub(crate) fn title(&self) -> String {
        let name = self.scene.name();
        if self.number > 0.0 { format!("{name} {}", self.number) } else { name.to_owned() }
    }
}

fn general(scenes: &[SceneName]) -> Vec<Case> {
    scenes.iter().map(|&scene| Case { scene, role: Role::General, number: 0.0 }).collect()
}

fn numbered(scene: SceneName, role: Role, numbers: &[f64]) -> impl Iterator<Item = Case> {
    numbers.iter().map(move |&number| Case { scene, role, number })
}

/// What is asked for by size, so the same in both sets: wedges, thin parts, pores.
fn common(mut cases: Vec<Case>) -> Vec<Case> {
    cases.extend(numbered(SceneName::Wedge, Role::General, &[60.0, 30.0]));
    for scene in [SceneName::ThinPlate, SceneName::ThinGap, SceneName::ThinLayer] {
        cases.extend(numbered(scene, Role::Thin, &[2.5, 3.0]));
    }
    cases.push(Case { scene: SceneName::Pores, role: Role::Small, number: 0.0 });
    cases
}

/// The objects to tune a method on.
pub(crate) fn tuning() -> Vec<Case> {
    let mut cases = common(general(&[
        SceneName::Sphere,
        SceneName::Steps,
        SceneName::CubeInCube,
        SceneName::PressFitRing,
        SceneName::SphereOnCylinder,
        SceneName::FourMaterials,
    ]));
    cases.extend(numbered(SceneName::Fillet, Role::Fillet, &[1.0, 3.0, 6.0]));
    cases
}

/// The objects to judge it by; rotations and seeds differ too.
pub(crate) fn held_out() -> Vec<Case> {
    let mut cases = common(general(&[
        SceneName::Sphere,
        SceneName::Cube,
        SceneName::FlushCubes,
        SceneName::BoltInPlate,
        SceneName::FourMaterials,
    ]));
    cases.extend(numbered(SceneName::Wedge, Role::General, &[105.0]));
    cases.extend(numbered(SceneName::Fillet, Role::Fillet, &[1.5, 2.0, 4.5]));
    cases
}
