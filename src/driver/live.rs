//! `insitu live`: frames in, augmented frames and a video out.

use crate::artefact::json;
use crate::composite::write_png;
use crate::config::Setup;
use crate::error::{Context as _, Error, FileContext, Result};
use crate::exposure::{Photograph, decode};
use crate::image::CodeImage;
use crate::live::{Live, Phantoms, Problem};
use crate::model::Scene;
use crate::printer::Printer;
use crate::render::load_object;
use crate::response::Response;
use crate::stage::Workspace;
use crate::vision::{VideoReader, VideoWriter};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Instant;

const READING: &str = "reading the frames";

/// Frames from wherever they come.
enum Source {
    Folder(VecDeque<PathBuf>),
    Video(VideoReader, PathBuf),
}

impl Source {
    /// A folder of pictures, a video file, or `camera:N`.
    fn open(path: &Path, base: &Path) -> Result<Self> {
        let device = path.to_str().and_then(|p| p.strip_prefix("camera:"));
        let path = if device.is_some() { path.to_owned() } else { base.join(path) };
        let refuse = |e: crate::vision::Problem| {
            let hint = crate::error::Problem::hint(&e);
            Error::file(READING, &path, e, hint)
        };
        if let Some(number) = device {
            let number = number.parse().map_err(|_| {
                Error::file(READING, &path, "is no camera", "name a device as camera:0, camera:1 …")
            })?;
            return Ok(Self::Video(VideoReader::device(number).map_err(refuse)?, path));
        }
        if !path.is_dir() {
            std::fs::metadata(&path).at(READING, &path)?;
            return Ok(Self::Video(VideoReader::file(&path).map_err(refuse)?, path));
        }
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&path).at(READING, &path)? {
            let file = entry.at(READING, &path)?.path();
            let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
            if ["jpg", "jpeg", "png", "tif", "tiff"].contains(&extension.as_str()) {
                files.push(file);
            }
        }
        files.sort();
        Ok(Self::Folder(files.into()))
    }

    fn frames_per_second(&self) -> Option<f64> {
        match self {
            Self::Folder(_) => None,
            Self::Video(video, _) => video.frames_per_second(),
        }
    }

    fn frame(&mut self) -> Result<Option<CodeImage>> {
        match self {
            Self::Folder(files) => {
                let Some(file) = files.pop_front() else { return Ok(None) };
                match decode(&file)? {
                    Photograph::Codes(codes) => Ok(Some(codes)),
                    Photograph::Linear(_) => {
                        Err(Error::file(READING, &file, "is linear", "give frames as a camera stores them"))
                    }
                }
            }
            Self::Video(video, path) => video.frame().map_err(|e| {
                let hint = crate::error::Problem::hint(&e);
                Error::file(READING, path, e, hint)
            }),
        }
    }
}

/// The frames of both cameras.
pub(crate) struct Film {
    frames: Source,
    others: Option<Source>,
    other: Option<CodeImage>,
    rate: f64,
}

impl Film {
    /// Of the settings.
    pub fn open(workspace: &Workspace) -> Result<Self> {
        let (live, base) = (&workspace.pipeline.live, &workspace.base);
        let frames = Source::open(&live.frames, base)?;
        let others = match (&live.environment, live.setup) {
            (Some(environment), Setup::TwoCameras | Setup::Fisheye) => {
                Some(Source::open(&environment.frames, base)?)
            }
            _ => None,
        };
        let rate = frames.frames_per_second().unwrap_or(live.frames_per_second);
        Ok(Self { frames, others, other: None, rate })
    }

    /// The next frame, with the second camera's where there is one. That one's last frame stays.
    pub fn next(&mut self) -> Result<Option<(CodeImage, Option<CodeImage>)>> {
        let Some(frame) = self.frames.frame()? else { return Ok(None) };
        if let Some(source) = &mut self.others {
            match source.frame()? {
                Some(other) => self.other = Some(other),
                None if self.other.is_none() => {
                    return Err(Problem::Empty).doing("reading the second camera's frames");
                }
                None => self.others = None,
            }
        }
        Ok(Some((frame, self.other.clone())))
    }
}

/// A session for frames of some sizes, px.
pub(crate) fn session(
    workspace: &Workspace,
    size: (usize, usize),
    second: Option<(usize, usize)>,
) -> Result<Live> {
    let (pipeline, base) = (&workspace.pipeline, &workspace.base);
    let live = &pipeline.live;
    let response = match &live.response {
        Some(path) => json::read(&base.join(path))?,
        None => Response::srgb(),
    };
    let scene = live.scene.as_ref().map(|path| json::read::<Scene>(&base.join(path))).transpose()?;
    let phantoms = Phantoms::of(live, scene.as_ref()).doing("reading what the scene is made of")?;
    let object = load_object(&base.join(&pipeline.render.object), &pipeline.render)?;
    Live::new(pipeline, response, object, phantoms, size, second).doing("preparing the film")
}

/// Runs until the frames end.
pub fn live(settings: &Path, printer: &Printer) -> Result<()> {
    let workspace = Workspace::open(settings)?;
    let live = &workspace.pipeline.live;
    let mut film = Film::open(&workspace)?;
    let doing = "putting the object into the film";
    let first = film.next()?.ok_or(Problem::Empty).doing(doing)?;
    let size = first.0.size();
    let mut session = session(&workspace, size, first.1.as_ref().map(CodeImage::size))?;
    let folder = workspace.base.join(&live.output);
    std::fs::create_dir_all(&folder).at("making a folder for the frames", &folder)?;
    let path = folder.join("live.avi");
    let mut video = VideoWriter::create(&path, size, film.rate).doing("writing the video")?;
    let mut report = Report::default();
    let (started, mut next) = (Instant::now(), Some(first));
    while let Some((frame, other)) = next {
        let arrived = Instant::now();
        let output = session.frame(&frame, other.as_ref()).doing(doing)?;
        report.latency.push(1e3 * arrived.elapsed().as_secs_f64());
        output.notices.iter().for_each(|notice| printer.warn(notice));
        report.add(&output);
        write_png(&folder.join(format!("frame_{:04}.png", report.latency.len() - 1)), &output.picture)?;
        video.write(&output.picture).doing("writing the video")?;
        if report.latency.len() == live.most_frames {
            break;
        }
        next = film.next()?;
    }
    session.finish().doing(doing)?;
    report.tell(started.elapsed().as_secs_f64(), size, printer);
    printer.data(&path.display().to_string());
    Ok(())
}

/// What frames took, ms, and how many lights they had.
#[derive(Default)]
struct Report {
    latency: Vec<f64>,
    parts: [Vec<f64>; 5],
    lights: usize,
    augmented: usize,
}

impl Report {
    fn add(&mut self, output: &crate::live::Output) {
        let t = output.timing;
        let times = [t.pose, t.light, t.maps, t.shadow, t.object];
        self.parts.iter_mut().zip(times).for_each(|(part, ms)| part.push(ms));
        self.lights = self.lights.max(output.lights);
        self.augmented += usize::from(output.lights > 0);
    }

    fn tell(&mut self, seconds: f64, (width, height): (usize, usize), printer: &Printer) {
        let median = |ms: &mut Vec<f64>| {
            ms.sort_by(f64::total_cmp);
            ms.get(ms.len() / 2).copied().unwrap_or(0.0)
        };
        let frames = self.latency.len();
        printer.data(&format!(
            "{frames} frames of {width}×{height} px, {} with the object, up to {} lights: {:.1} frames/s with all files written",
            self.augmented,
            self.lights,
            frames as f64 / seconds
        ));
        let latency = median(&mut self.latency);
        let [pose, light, maps, shadow, object] = self.parts.each_mut().map(median);
        printer.data(&format!(
            "latency {latency:.1} ms (median): pose {pose:.1}, light {light:.1}, maps {maps:.1}, shadow {shadow:.1}, object {object:.1}"
        ));
    }
}
