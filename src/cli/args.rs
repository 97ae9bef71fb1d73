//! Parsing and output conventions that verbs share.

use std::{path::Path, str::FromStr};

use super::Failure;
use crate::{
    exercise::{Altitude, Frame},
    los::Earth,
    roam::Fidelity,
    terrain::{EARTH_RADIUS_M, SceneScale},
};

/// `X,Y,Z` on the command line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Point(
    /// The three numbers.
    pub [f64; 3],
);

impl FromStr for Point {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<_> = text.split(',').collect();
        let [x, y, z] = parts[..] else {
            return Err(format!("'{text}' is not X,Y,Z: three numbers with commas between them"));
        };
        let number = |part: &str| match part.trim().parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(format!("'{part}' in '{text}' is not a finite number")),
        };
        Ok(Self([number(x)?, number(y)?, number(z)?]))
    }
}

/// What sight lines ask of a mesh: `verdict`, `obstruction:M` (metres), `wedgie` or `profile`.
pub fn fidelity(text: &str) -> Result<Fidelity, String> {
    let wrong = || format!("'{text}' is not verdict, obstruction:M (metres, not negative), wedgie or profile");
    match text.split_once(':') {
        None => match text {
            "verdict" => Ok(Fidelity::Verdict),
            "wedgie" => Ok(Fidelity::Wedgie),
            "profile" => Ok(Fidelity::Profile),
            _ => Err(wrong()),
        },
        Some(("obstruction", metres)) => match metres.parse::<f64>() {
            Ok(distance_m) if distance_m.is_finite() && distance_m >= 0.0 => Ok(Fidelity::Obstruction { distance_m }),
            _ => Err(wrong()),
        },
        Some(_) => Err(wrong()),
    }
}

/// Refuses to write over a file that exists, unless `force`.
pub fn refuse_existing(path: &Path, force: bool) -> Result<(), Failure> {
    if !force && path.exists() {
        return Err(Failure::Environment(format!("{} exists; give --force to replace it", path.display())));
    }
    Ok(())
}

/// How the positions on a command line, or in a file that it names, are meant.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct Positions {
    /// The frame of positions: posts and height units; the elevation model's own reference system and metres; or
    /// longitude, latitude and metres, on terrain whose map is in degrees, a UTM zone or web Mercator.
    #[arg(long, value_enum, default_value_t = Coords::Map)]
    coords: Coords,
    /// What the third number means: above the vertical datum, or above ground level.
    #[arg(long, value_enum, default_value_t = AltitudeName::Absolute)]
    altitude: AltitudeName,
}

/// How plan positions are meant.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct Plan {
    /// The frame of positions: posts and height units; the elevation model's own reference system and metres; or
    /// longitude, latitude and metres, on terrain whose map is in degrees, a UTM zone or web Mercator.
    #[arg(long, value_enum, default_value_t = Coords::Map)]
    coords: Coords,
}

impl Plan {
    /// The frame.
    pub fn frame(self) -> Frame {
        self.coords.frame()
    }
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Coords {
    Grid,
    Map,
    Geographic,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum AltitudeName {
    Absolute,
    Agl,
}

impl Coords {
    fn frame(self) -> Frame {
        match self {
            Self::Grid => Frame::Grid,
            Self::Map => Frame::Map,
            Self::Geographic => Frame::Geographic,
        }
    }
}

impl Positions {
    /// The frame.
    pub fn frame(self) -> Frame {
        self.coords.frame()
    }

    /// What the third number means.
    pub fn altitude(self) -> Altitude {
        match self.altitude {
            AltitudeName::Absolute => Altitude::Absolute,
            AltitudeName::Agl => Altitude::AboveGround,
        }
    }
}

/// The shape of the Earth under lines of sight.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct EarthShape {
    /// Lines are straight over a flat Earth, or lowered by the bulge of a sphere, t (1 - t) L^2 / (2 k R).
    #[arg(long, value_enum, default_value_t = EarthName::Flat)]
    earth: EarthName,
    /// Radius R of the sphere in metres; the default is the Earth's mean radius.
    #[arg(long, value_name = "METRES", default_value_t = EARTH_RADIUS_M)]
    earth_radius: f64,
    /// Factor k of refraction, by which the radius is enlarged: 1 is none, 1.15 usual for light, 1.333 for radio.
    #[arg(long, value_name = "K", default_value_t = 1.0)]
    refraction: f64,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq, Debug)]
enum EarthName {
    Flat,
    Sphere,
}

impl EarthShape {
    /// Radius in metres and factor of refraction; `None` where lines are straight.
    pub fn sphere(self) -> Option<(f64, f64)> {
        (self.earth == EarthName::Sphere).then_some((self.earth_radius, self.refraction))
    }

    /// The shape under a grid of that scale.
    pub fn earth(self, scale: SceneScale) -> Result<Earth, Failure> {
        let Some((radius_m, refraction)) = self.sphere() else { return Ok(Earth::Flat) };
        Earth::sphere(radius_m, refraction, scale).map_err(|error| Failure::Usage(error.to_string()))
    }
}
