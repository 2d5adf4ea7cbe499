//! Tests of the page against a virtual controller of this process.

mod browser;
mod chromium;
mod jog;
mod pages;
mod panel;
mod raw;
mod safety;
mod screens;
mod support;
mod work;
