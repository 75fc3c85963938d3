mod edge;
mod sample;
mod words;
