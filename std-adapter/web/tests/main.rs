//! Tests of the page against a virtual controller of this process.

mod browser;
mod chromium;
mod jog;
mod pages;
mod raw;
mod panel;
mod safety;
mod screens;
mod support;
mod work;
