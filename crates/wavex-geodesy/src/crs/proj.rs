//! CRSs that the built-in code rejects, through the library PROJ (feature `proj`): other datums,
//! axes, meridians.
//!
//! Horizontal coordinates are PROJ's, from WGS 84 with its height; transformations without a datum
//! shift ("ballpark") are rejected. At each position PROJ uses its best transformation among those
//! whose grids it finds. Heights stay above the WGS 84 ellipsoid, or above the geoid: on another
//! datum's ellipsoid they would be meaningless.
//!
//! PROJ objects belong to one thread, so each thread has its own. The crate `proj` takes every
//! height as 0, which shifts positions on other datums, and panics for systems without WKT 1; hence
//! the bindings of `proj-sys` for both.

use std::cell::RefCell;
use std::collections::HashMap;
use std::ffi::{CStr, CString};
use std::sync::atomic::{AtomicU64, Ordering};

use proj_sys as sys;

use super::AreaOfUse;

/// A CRS of PROJ, opened separately by every thread.
#[derive(Debug)]
pub(in crate::crs) struct Foreign {
    definition: CString,
    /// Key of the thread's opened objects.
    number: u64,
}

thread_local! {
    static OPENED: RefCell<HashMap<u64, Option<ProjTransformation>>> = RefCell::new(HashMap::new());
}

static NEXT: AtomicU64 = AtomicU64::new(0);

impl Foreign {
    /// The CRS of a PROJ definition: `EPSG:27700`, or WKT.
    ///
    /// `None` if PROJ does not understand it, or has no transformation from WGS 84.
    pub(super) fn new(definition: &str) -> Option<Foreign> {
        let definition = CString::new(definition.trim_end_matches('\0')).ok()?;
        let foreign = Foreign { definition, number: NEXT.fetch_add(1, Ordering::Relaxed) };
        foreign.with(|_| ()).map(|()| foreign)
    }

    /// The CRS as WKT 1.
    pub(super) fn wkt(&self) -> Option<String> {
        let context = ProjContext::new()?;
        let system = Object::of(&context, &self.definition)?;
        let options = [c"MULTILINE=NO".as_ptr(), std::ptr::null()];
        // SAFETY: both are alive, and the options end with null, as PROJ requires.
        let text =
            unsafe { sys::proj_as_wkt(context.0, system.0, sys::PJ_WKT_TYPE_PJ_WKT1_GDAL, options.as_ptr()) };
        if text.is_null() {
            return None;
        }
        // SAFETY: the text is null-terminated and belongs to the object, which is alive during the
        // copy.
        let text = unsafe { CStr::from_ptr(text) };
        Some(text.to_string_lossy().into_owned())
    }

    /// Area of use in PROJ's database, or of the definition itself.
    pub(super) fn area_of_use(&self) -> Option<AreaOfUse> {
        let (area, _) = proj::Proj::new(self.definition.to_str().ok()?).ok()?.area_of_use().ok()?;
        area.map(|proj::Area { west, south, east, north }| AreaOfUse { west, south, east, north })
    }

    /// x and y of longitude and latitude, degrees, and ellipsoidal height on WGS 84, m.
    pub(super) fn project(&self, longitude_deg: f64, latitude_deg: f64, height_m: f64) -> Option<[f64; 2]> {
        let point = [longitude_deg, latitude_deg, height_m, f64::INFINITY];
        self.with(|opened| opened.transform(sys::PJ_DIRECTION_PJ_FWD, point))?.map(|[x, y, ..]| [x, y])
    }

    /// Longitude and latitude, degrees, of x and y at a height, m.
    ///
    /// PROJ's inverse of a seven-parameter datum shift is off by 1 mm; the residual of the forward
    /// transformation corrects it.
    pub(super) fn unproject(&self, x: f64, y: f64, height_m: f64) -> Option<[f64; 2]> {
        self.with(|opened| {
            let inverse = |[x, y]: [f64; 2]| {
                opened.transform(sys::PJ_DIRECTION_PJ_INV, [x, y, height_m, f64::INFINITY])
            };
            let mut asked = [x, y];
            let mut place = inverse(asked)?;
            for _ in 0..2 {
                let point = [place[0], place[1], height_m, f64::INFINITY];
                let found = opened.transform(sys::PJ_DIRECTION_PJ_FWD, point)?;
                asked = [asked[0] + x - found[0], asked[1] + y - found[1]];
                place = inverse(asked)?;
            }
            Some([place[0], place[1]])
        })?
    }

    /// Calls `act` with this thread's objects, opened on first use.
    fn with<T>(&self, act: impl FnOnce(&ProjTransformation) -> T) -> Option<T> {
        OPENED.with_borrow_mut(|all| {
            let opened = all.entry(self.number).or_insert_with(|| ProjTransformation::new(&self.definition));
            opened.as_ref().map(act)
        })
    }
}

/// A PROJ context; its objects must stay in one thread.
struct ProjContext(*mut sys::PJ_CONTEXT);

impl ProjContext {
    fn new() -> Option<ProjContext> {
        // SAFETY: the function has no preconditions; it returns null on failure.
        let context = unsafe { sys::proj_context_create() };
        if context.is_null() {
            return None;
        }
        // SAFETY: the context was just created. Errors are reported by wavex, not on standard
        // error.
        unsafe { sys::proj_log_level(context, sys::PJ_LOG_LEVEL_PJ_LOG_NONE) };
        Some(ProjContext(context))
    }
}

impl Drop for ProjContext {
    fn drop(&mut self) {
        // SAFETY: the context is alive, and all its objects are gone: fields drop in order.
        unsafe { sys::proj_context_destroy(self.0) };
    }
}

/// A CRS or operation of PROJ; never null.
struct Object(*mut sys::PJ);

impl Object {
    fn of(context: &ProjContext, definition: &CStr) -> Option<Object> {
        // SAFETY: the context is alive and the text is null-terminated.
        Object::unless_null(unsafe { sys::proj_create(context.0, definition.as_ptr()) })
    }

    fn unless_null(object: *mut sys::PJ) -> Option<Object> {
        (!object.is_null()).then_some(Object(object))
    }
}

impl Drop for Object {
    fn drop(&mut self) {
        // SAFETY: the object is alive: it is created once and destroyed only here.
        unsafe { sys::proj_destroy(self.0) };
    }
}

/// Transformation from WGS 84 to a CRS; the operation drops before its context.
struct ProjTransformation {
    operation: Object,
    _context: ProjContext,
}

impl ProjTransformation {
    fn new(definition: &CStr) -> Option<ProjTransformation> {
        let context = ProjContext::new()?;
        let (from, to) = (Object::of(&context, c"EPSG:4979")?, Object::of(&context, definition)?);
        let options = [c"ALLOW_BALLPARK=NO".as_ptr(), std::ptr::null()];
        // SAFETY: all are alive; a null area is allowed; the options end with null, as PROJ
        // requires.
        let operation = Object::unless_null(unsafe {
            sys::proj_create_crs_to_crs_from_pj(
                context.0,
                from.0,
                to.0,
                std::ptr::null_mut(),
                options.as_ptr(),
            )
        })?;
        // SAFETY: both are alive; the result is a new object.
        let operation =
            Object::unless_null(unsafe { sys::proj_normalize_for_visualization(context.0, operation.0) })?;
        Some(ProjTransformation { operation, _context: context })
    }

    fn transform(&self, direction: sys::PJ_DIRECTION, point: [f64; 4]) -> Option<[f64; 4]> {
        // SAFETY: the operation is alive and belongs to this thread; every member of the union has
        // at most four doubles.
        let found = unsafe {
            sys::proj_errno_reset(self.operation.0);
            sys::proj_trans(self.operation.0, direction, sys::PJ_COORD { v: point }).v
        };
        found.iter().take(2).all(|value| value.is_finite()).then_some(found)
    }
}
