//! What a browser calls: four functions by name, and memory in between.
//!
//! The page asks for room, writes a request there, has it answered and reads the answer where it lies. No code here is
//! unsafe; that a name is exported is what the lint means.
#![allow(unsafe_code)]

use crate::requests::{Answer, Desk};
use std::cell::RefCell;

/// What lies between two calls.
#[derive(Default)]
struct Counter {
    desk: Desk,
    request: Vec<u8>,
    answer: Answer,
}

thread_local! {
    static COUNTER: RefCell<Counter> = RefCell::default();
}

/// Makes room for a request of so many bytes and says where.
#[no_mangle]
pub extern "C" fn fastslam_room(bytes: usize) -> *mut u8 {
    COUNTER.with_borrow_mut(|counter| {
        counter.request.clear();
        counter.request.resize(bytes, 0);
        counter.request.as_mut_ptr()
    })
}

/// Answers the request: 0 for numbers (doubles), 1 for JSON, 2 for the text of an error.
#[no_mangle]
pub extern "C" fn fastslam_answer() -> u32 {
    COUNTER.with_borrow_mut(|counter| {
        let Counter { desk, request, answer } = counter;
        *answer = desk.answer(request);
        match answer {
            Answer::Numbers(_) => 0,
            Answer::Json(_) => 1,
            Answer::Error(_) => 2,
        }
    })
}

/// Where the answer lies.
#[no_mangle]
pub extern "C" fn fastslam_answer_place() -> *const u8 {
    COUNTER.with_borrow(|counter| match &counter.answer {
        Answer::Numbers(numbers) => numbers.as_ptr().cast(),
        Answer::Json(text) | Answer::Error(text) => text.as_ptr(),
    })
}

/// How many bytes it has.
#[no_mangle]
pub extern "C" fn fastslam_answer_bytes() -> usize {
    COUNTER.with_borrow(|counter| match &counter.answer {
        Answer::Numbers(numbers) => size_of_val(numbers.as_slice()),
        Answer::Json(text) | Answer::Error(text) => text.len(),
    })
}
