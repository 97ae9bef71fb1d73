//! The gRPC services: conversion, limits, status codes. The only module with sockets beside `cli`.
