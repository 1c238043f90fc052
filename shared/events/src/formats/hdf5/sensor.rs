//! The size of the sensor, from attributes.

use super::column::{ForType, Number, for_type};
use super::unreadable;
use evpr_core::plan::Sensor;
use hdf5_reader::Attribute;
use hdf5_reader::error::Error;
use hdf5_reader::group::Group;

/// The attribute of the first of these groups that has it, and a name for it.
fn attribute(places: &[(&str, &Group)], name: &str) -> Result<Option<(String, Attribute)>, String> {
    for (place, group) in places {
        let what = format!("attribute {name} of {place}");
        match group.attribute(name) {
            Ok(attribute) => return Ok(Some((what, attribute))),
            Err(Error::AttributeNotFound(_)) => {}
            Err(e) => return Err(unreadable(&what, &e)),
        }
    }
    Ok(None)
}

/// What the attributes of these groups say, the first of them before the others.
pub(super) fn of(places: &[(&str, &Group)]) -> Result<Option<Sensor>, String> {
    let one = |name| match attribute(places, name)? {
        Some((what, found)) => {
            let value = found.read_as_f64().map_err(|e| unreadable(&what, &e))?;
            side(&what, value).map(Some)
        }
        None => Ok(None),
    };
    if let Some((height, width)) = one("height")?.zip(one("width")?) {
        return Ok(Some(Sensor { height, width }));
    }
    let (what, height, width) = if let Some((what, found)) = attribute(places, "sensor_resolution")? {
        let read = for_type(&found.datatype, Numbers(&found)).unwrap_or(Ok(Vec::new()));
        let values = read.map_err(|e| unreadable(&what, &e))?;
        let [height, width, ..] = values[..] else {
            return Err(format!(
                "{what} has {} numbers; it must be height and width",
                values.len()
            ));
        };
        (what, height, width)
    } else if let Some((what, found)) = attribute(places, "geometry")? {
        let text = found.read_string().map_err(|e| unreadable(&what, &e))?;
        let sides = text.trim().split_once('x');
        let sides = sides.and_then(|(width, height)| Some((height.parse().ok()?, width.parse().ok()?)));
        let (height, width) = sides.ok_or_else(|| {
            let text: String = text.chars().take(40).flat_map(char::escape_debug).collect();
            format!("{what} is \"{text}\"; it must be width x height, as in 640x480")
        })?;
        (what, height, width)
    } else {
        return Ok(None);
    };
    Ok(Some(Sensor {
        height: side(&what, height)?,
        width: side(&what, width)?,
    }))
}

fn side(what: &str, value: f64) -> Result<usize, String> {
    if value.fract() != 0.0 || !(1.0..=65_535.0).contains(&value) {
        return Err(format!(
            "{what} is {value}; it must be a whole number from 1 to 65535"
        ));
    }
    Ok(value as usize)
}

/// The numbers of an attribute of one dimension.
struct Numbers<'a>(&'a Attribute);

impl ForType for Numbers<'_> {
    type Out = Result<Vec<f64>, Error>;
    fn run<S: Number>(self) -> Self::Out {
        let values = self.0.read_1d::<S>()?;
        Ok(values.iter().map(|v| v.rough()).collect())
    }
}
